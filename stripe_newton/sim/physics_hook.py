# SPDX-License-Identifier: Apache-2.0
"""Physics hook: work that runs at fixed points of the physics."""

from __future__ import annotations

__all__ = ["PhysicsHook"]


class PhysicsHook:
    """Base of what takes part in the physics: sensors, collider slots, limits that follow the model.

    A hook overrides the methods that it needs and is added by :meth:`Simulation.add_hook`; hooks run in the order in
    which they were added. Each step of an environment runs them so::

        launch_before_steps()
        for each of its physics steps:
            ... actuators, collision detection, solver ...
            launch_after_step()

    The ``launch_*`` methods launch kernels on the current device and do nothing else. On a GPU they run once, while a
    CUDA graph is recorded, and the graph is replayed without Python ever after. So they must not read the device
    (which would wait for it, and is forbidden during a recording), must not allocate arrays that later launches need,
    and must not decide by anything that changes from step to step: such a decision belongs in a kernel. The arrays
    that they hand to kernels must be the same ones for life, or :meth:`Simulation.recapture` must be called.
    """

    @property
    def follows_each_step(self) -> bool:
        """Whether :meth:`launch_after_step` must run after every physics step.

        Otherwise once after several suffices, which lets a solver take them in one launch. By default True for a class
        that overrides it.
        """
        return type(self).launch_after_step is not PhysicsHook.launch_after_step

    def launch_before_steps(self) -> None:
        """Launch what runs once before the physics steps that are launched together."""

    def launch_after_step(self) -> None:
        """Launch what runs after every physics step, on the state that it made."""

    def launch_after_notify(self) -> None:
        """Launch what runs after the solver took over changed properties of the model, see :meth:`Simulation.notify`.

        The solver then has overwritten whatever a hook had written to the solver's own arrays. Events of an
        environment that change the model may be part of its graph, so this method may be recorded too.
        """

    def report_overflow(self) -> str:
        """Name the sizes that were too small since the last call, and what to set; empty if everything fitted.

        It is called on the host before every step, and never recorded. It must not wait for the device: read a
        :class:`stripe_newton.sim.host_flags.HostFlags` that a kernel writes.
        """
        return ""
