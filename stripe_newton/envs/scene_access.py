# SPDX-License-Identifier: Apache-2.0
"""Scene access: pictures, saved states and single terms of a built scene, between its steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
import warp as wp

from stripe_newton.call_checks import check_state, checked_function, checked_seed
from stripe_newton.managers import TermEvaluation

from .built_scene import BuiltScene
from .env_pictures import EnvPictures
from .env_state import EnvState, restore_state, save_state
from .without_gradients import without_gradients

if TYPE_CHECKING:
    from stripe_newton.viewers import SceneRenderer

__all__ = ["SceneAccess"]


class SceneAccess(BuiltScene):
    """A built scene, with pictures of it, states to restore, and Warp terms on its present state."""

    _pictures: EnvPictures | None = None
    _evaluates: TermEvaluation | None = None
    _shows_debug: bool = False
    """Whether ``_debug_vis_callback`` runs before a picture."""

    # -- pictures

    def render(self) -> np.ndarray | None:
        """A picture of the scene, uint8, shape ``(height, width, 3)``; ``None`` without ``render_mode="rgb_array"``.

        Newton's camera sensor ray traces it, so neither a display nor a graphics library is needed.
        """
        self._check_open()
        if self.render_mode != "rgb_array":
            return None
        if self._pictures is None:
            self._pictures = EnvPictures(self)
        self.update_debug_vis()
        return self._pictures.render()

    def set_debug_vis(self, debug_vis: bool) -> bool:
        """Show or hide what ``_set_debug_vis_impl`` and ``_debug_vis_callback`` draw; whether there is anything."""
        try:
            self._set_debug_vis_impl(debug_vis)
        except NotImplementedError:
            return False
        self._shows_debug = debug_vis
        return True

    def update_debug_vis(self) -> None:
        """Move the markers of a subclass to their present places; :meth:`render` and the live view call it."""
        if self._shows_debug:
            self._debug_vis_callback(None)

    def _set_debug_vis_impl(self, debug_vis: bool) -> None:
        """Make the markers at the first call, and show or hide them."""
        raise NotImplementedError

    def _debug_vis_callback(self, event: object) -> None:
        """Move the markers, before each picture. It is no part of a step: a training without pictures skips it.

        Args:
            event: None; the argument is there for classes of Isaac Lab.
        """

    @property
    def renderer(self) -> SceneRenderer | None:
        """The renderer of :meth:`render`, None before its first picture."""
        return None if self._pictures is None else self._pictures.renderer

    def close_extras(self, **kwargs: object) -> None:
        """Release renderer and simulation."""
        self._close_pictures()
        super().close_extras(**kwargs)

    def _close_pictures(self) -> None:
        if self._pictures is not None:
            self._pictures.close()
            self._pictures = None

    # -- Warp terms from torch code

    @torch.no_grad()
    def evaluate(self, term: wp.Function, **params: object) -> torch.Tensor:
        """Value of a Warp term on the present state, for torch hooks and terms.

        Args:
            term: An observation, reward or termination term, such as ``mdp.joint_pos_rel``.
            params: Its parameters, as in the config of a term.

        Returns:
            A new tensor: ``(num_envs, size)`` for an observation, ``(num_envs,)`` for rewards and terminations.

        Raises:
            ConfigError: parameters that do not fit.
        """
        return self._evaluation.value(checked_function(term, "term"), params)

    @torch.no_grad()
    def apply_event(
        self, event: wp.Function, env_ids: Sequence[int] | torch.Tensor | None = None, **params: object
    ) -> None:
        """Run a Warp event, such as ``mdp.randomize_rigid_body_mass``, in some environments; None means all of them.

        Raises:
            ConfigError: parameters that do not fit.
        """
        self._evaluation.apply(checked_function(event, "event"), env_ids, params)

    @property
    def _evaluation(self) -> TermEvaluation:
        self._check_open()
        if self._evaluates is None:
            self._evaluates = TermEvaluation(self.context)
        return self._evaluates

    # -- saving and restoring

    def get_state(self) -> EnvState:
        """State that the next step depends on; :meth:`set_state` restores it.

        It has joints, targets, the solver's warm start, counters, and every tensor that the subclass keeps as an
        attribute.
        """
        self._check_open()
        return save_state(self)

    @without_gradients
    def set_state(self, state: EnvState) -> None:
        """Restore a state of :meth:`get_state`; steps from there on repeat those that followed it.

        Raises:
            ValueError: if it is the state of another environment.
        """
        self._check_open()
        check_state(state)
        seed = state.get("scenery_seed", self.scene.first_scenery_seed)
        if isinstance(seed, int) and seed != self.scene.scenery_seed:
            self._move_to_scene(seed)
        restore_state(self, state)

    def state_parts(self) -> list[dict[str, torch.Tensor]]:
        """Parts of the state that are not attributes of the environment, as the dicts of tensors that hold them."""
        return []

    @without_gradients
    def _move_to_scene(self, seed: int) -> None:
        self._check_open()
        self.scene.regenerate(checked_seed(seed))
        self._close_pictures()
