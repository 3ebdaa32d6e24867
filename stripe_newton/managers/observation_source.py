# SPDX-License-Identifier: Apache-2.0
"""Observation source: source code of an observation term, from its call to the memory of its group.

Each number passes modifiers, noise, clip, scale, delay and history, in this order.

A term with uniform noise, the first of its group, becomes part 0 of a section, which a thread of its own computes::

    if part == 0:
        base_lin_vel(env, robot, obs_policy[env, 0 + 0:0 + 3])
        for i in range(0, 3):
            obs_policy[env, i] = combine_noise(
                obs_policy[env, i], sample_uniform(env, base_lin_vel_rng, parameters[43], parameters[44]), 0)
"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from stripe_kernels.term_info import Each, observation_size
from stripe_newton.fusion import Code, block, code
from stripe_newton.noise import NoiseModelCfg, NoiseModelWithAdditiveBiasCfg

from .context import ManagerContext
from .modifiers import modifier_lines
from .observation_term import ObservationTerm
from .processing import NoiseSource, delay_of

__all__ = ["MIN_PARTS_FOR_PARALLEL_NOISE", "ObservationSource"]

MIN_PARTS_FOR_PARALLEL_NOISE = 8
"""Least number of independent parts, such as rays or joints, for which each part of a noisy term has its own thread and
random stream. Threads of neighbouring parts read and write neighbouring numbers, which a GPU moves together; one thread
that goes through all parts of its environment waits for each of them, and uses a part of what is moved."""


class ObservationSource:
    """Source code of one observation term."""

    def __init__(self, context: ManagerContext, term: ObservationTerm, corrupt: bool, again: bool = False):
        """Bind to a term.

        Args:
            context: The context of the managers.
            term: The term.
            corrupt: Whether the noise of the term is applied.
            again: Whether values replace the last ones in delays and histories, rather than follow them.
        """
        self._context, self._term, self._again = context, term, again
        # Noise and modifiers in torch have been applied before.
        self._corrupt = corrupt and term.processing is None
        self._modifiers = term.cfg.modifiers or () if term.processing is None else ()

    @property
    def parts(self) -> int:
        """Number of parts with a thread each; 0 if one thread computes the whole term."""
        parts, noise = self._term.parts, self._term.cfg.noise
        return 0 if self._corrupt and noise is not None and parts < MIN_PARTS_FOR_PARALLEL_NOISE else parts

    # -- in every step

    def lines(self, first_part: int) -> tuple[list[Code], int]:
        """Lines of the term in the section of its group.

        Args:
            first_part: Index of the term's first part within the section.

        Returns:
            The lines, and the number of parts.
        """
        term, parts = self._term, self.parts
        if parts:
            call, process = self.part()
            body = [code("k = part - {}", first_part), call, *process]
            return block(code("if part >= {} and part < {}:", first_part, first_part + parts), body), parts
        place = code("{}[env]", term.scratch) if term.scratch else term.span("0", str(term.width))
        body = [term.call.expression(place)] if term.call is not None else []
        body += self._process("0", str(term.size))
        return (block(code("if part == {}:", first_part), body), 1) if body else ([], 0)

    def part(self) -> tuple[Code, list[Code]]:
        """The call of part ``k`` of the term, and the lines that process its numbers."""
        kind, call = observation_size(self._term.cfg.func), self._term.call
        assert call is not None
        assert isinstance(kind, Each)
        first, last = f"k * {kind.size}", f"(k + 1) * {kind.size}"
        line = call.expression(self._term.span(first, last), sliced=(kind.name,), span="k:k + 1")
        return line, self._process(first, last, streams=self.parts)

    def _process(self, first: str, last: str, streams: int = 1) -> list[Code]:
        """Lines that process the numbers from ``first`` to ``last`` after the call of the term.

        Noise draws from the stream of the term, or from that of part ``k`` if there are several.
        """
        term, cfg, element = self._term, self._term.cfg, self._term.element
        each = [*self._modify(), *self._add_noise(streams), *self._clip(), *self._scale()]
        lines = block(code("for i in range({}, {}):", first, last), each) if each else []
        if cfg.delay_max_lag:
            lines += delay_of(self._context, term.path, term.size, cfg).step(element, self._again)
        if term.history:
            lines += self._push(element)
        elif term.scratch:
            copy = code("{}[env, {} + i] = {}", term.target, term.first, element)
            lines += block(code("for i in range({}):", term.size), [copy])
        if self._modifiers and not term.history:
            lines.append(code("{}[env] = 0", self._fresh()))
        return lines

    def _modify(self) -> list[Code]:
        term, lines = self._term, list[Code]()
        for index, cfg in enumerate(self._modifiers):
            path = f"{term.path}.modifiers.{index}"
            lines += modifier_lines(self._context, path, cfg, term.size, term.element, self._fresh())
        return lines

    def _add_noise(self, streams: int) -> list[Code]:
        term, context, noise = self._term, self._context, self._term.cfg.noise
        if noise is None or not self._corrupt:
            return []
        cfg = noise.noise_cfg if isinstance(noise, NoiseModelCfg) else noise
        rng = context.scope.name(f"{term.path}_rng", context.stream(f"{term.path}.rng", streams))
        stream = f"env * {streams} + k" if streams > 1 else "env"
        lines = NoiseSource(context, f"{term.path}.noise", cfg, term.size, rng, stream).apply(term.element)
        if isinstance(noise, NoiseModelWithAdditiveBiasCfg):
            lines.append(code("{} = {} + {}", term.element, term.element, self._bias(noise)))
        return lines

    def _clip(self) -> list[Code]:
        term, clip = self._term, self._term.cfg.clip
        if clip is None:
            return []
        bounds = zip(("low", "high"), clip, strict=True)
        low, high = (self._context.parameters.add(f"{term.path}.clip.{n}", v, float) for n, v in bounds)
        return [code("{} = wp.clamp({}, {}, {})", term.element, term.element, low, high)]

    def _scale(self) -> list[Code]:
        term, context, scale = self._term, self._context, self._term.cfg.scale
        if scale is None:
            return []
        if isinstance(scale, Sequence):
            array = context.shared(f"{term.path}.scale", float, term.size)
            context.torch(array)[:] = torch.tensor([float(s) for s in scale])
            factor = code("{}[i]", context.scope.name(f"{term.path}_scale", array))
        else:
            factor = context.parameters.add(f"{term.path}.scale", scale, float)
        return [code("{} = {} * {}", term.element, term.element, factor)]

    def _push(self, element: Code) -> list[Code]:
        """Lines that append to the history, oldest first. The first observation of an episode fills all of it."""
        term, fresh = self._term, self._fresh()
        before = "k" if self._again else "(k + 1)"
        older = code(f"{{}}[env, {{}} + {before} * {{}} + i]", term.target, term.first, term.size)
        move = code(
            "{}[env, {} + k * {} + i] = wp.where({}[env] != 0, {}, {})",
            term.target, term.first, term.size, fresh, element, older,
        )  # fmt: skip
        newest = code("{}[env, {} + i] = {}", term.target, term.first + (term.history - 1) * term.size, element)
        return [
            *block(
                code("for i in range({}):", term.size),
                [*block(code("for k in range({}):", term.history - 1), [move]), newest],
            ),
            code("{}[env] = 0", fresh),
        ]

    # -- at the start of an episode

    def reset(self) -> list[Code]:
        """Lines that draw bias and lag where an episode begins, and mark history and filters for refilling."""
        term, lines = self._term, list[Code]()
        if term.cfg.delay_max_lag:
            lines += delay_of(self._context, term.path, term.size, term.cfg).reset()
        if term.history or self._modifiers:
            lines.append(code("{}[env] = 1", self._fresh()))
        if isinstance(term.cfg.noise, NoiseModelWithAdditiveBiasCfg) and self._corrupt:
            lines += self._draw_bias(term.cfg.noise)
        return lines

    def _draw_bias(self, cfg: NoiseModelWithAdditiveBiasCfg) -> list[Code]:
        count = self._bias_count(cfg)
        rng = self._context.code("{rng}")
        draw = NoiseSource(self._context, f"{self._term.path}.bias_noise", cfg.bias_noise_cfg, count, rng).draw()
        if draw is None:
            return []
        if cfg.bias_noise_cfg.operation == "scale":
            draw = code("0.0")  # a bias is its noise applied to zero, and scaling zero gives zero
        return block(code("for i in range({}):", count), [code("{} = {}", self._bias(cfg), draw)])

    def _bias(self, cfg: NoiseModelWithAdditiveBiasCfg) -> Code:
        count = self._bias_count(cfg)
        array = self._context.array(f"{self._term.path}.bias", float, count)
        name = self._context.scope.name(f"{self._term.path}_bias", array)
        return code("{}[env, {}]", name, "i" if count > 1 else 0)

    def _bias_count(self, cfg: NoiseModelWithAdditiveBiasCfg) -> int:
        return self._term.size if cfg.sample_bias_per_component else 1

    def _fresh(self) -> Code:
        """Name of the array that is not 0 until the first observation of an episode has been written."""
        array = self._context.array(f"{self._term.path}.fresh", int, fill=1)
        return self._context.scope.name(f"{self._term.path}_fresh", array)
