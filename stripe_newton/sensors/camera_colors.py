# SPDX-License-Identifier: Apache-2.0
"""Camera colours: shades what a camera sensor's rays find with the light, ground and sky of videos."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import warp as wp
from newton.sensors import SensorCamera

from stripe_kernels.sensors.camera_colors import color_pixels
from stripe_newton.viewers.camera_framing import USUAL_AZIMUTH
from stripe_newton.viewers.creases import crease_model
from stripe_newton.viewers.lighting import lighting_from
from stripe_newton.viewers.look import lit_look
from stripe_newton.viewers.recolor import recolor_model

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

__all__ = ["CameraColors"]


class CameraColors:
    """Light and air of a camera's pixels, the same as those of ``env.render()``.

    Newton's sensor finds distance, shape, normal and texture of each ray; its own colours have neither the ground's
    squares nor fog, highlights and tone curve, and large boxes have holes in them.

    Attributes:
        color: Packed colours that are written.
        lighting: Light of the scene.
        look: Light, air, and the size of a pixel.
        background: Packed colour where there is nothing; 0 for the sky.

    Args:
        sim: The simulation. Shapes without a colour of their own get those that pictures give them.
        color: Packed colours that are written, shape ``(num_envs, height, width)``.
        focal_length: Focal length along a column [px].
        textured: Whether a shape has a texture.
        shadows: Whether the sun casts shadows.
        background: sRGB where there is nothing, each from 0 to 1. None: the sky.
    """

    def __init__(
        self,
        sim: Simulation,
        color: wp.array,
        focal_length: float,
        textured: bool,
        shadows: bool,
        background: Sequence[float] | None,
    ):
        self._model, self.color = sim.model, color
        recolor_model(sim.model, sim.template, sim.static)
        crease_model(sim.model)
        # A sun that the scene lacks shines from where it does in pictures that frame themselves.
        self.lighting = lighting_from(sim.lights, azimuth=USUAL_AZIMUTH)
        self.look = lit_look(self.lighting)
        _, self.look.height, self.look.width = color.shape
        self.look.tan_y = 0.5 * self.look.height / focal_length
        self.background = 0
        if background is not None:
            red, green, blue = (round(255.0 * c) for c in background)
            self.background = 0xFF000000 | blue << 16 | green << 8 | red
        self._texture = wp.zeros(color.shape if textured else (0, 0, 0), dtype=wp.uint32)
        self._sunlight = wp.zeros(color.shape if shadows else (0, 0, 0), dtype=wp.vec3)
        self._no_casters = wp.zeros(1, dtype=float)

    def set_lights(self, sensor: SensorCamera) -> None:
        """Give the sensor a white sun alone: its light then says what lies in the shadow."""
        direction = wp.vec3(*(-self.lighting.to_sun).tolist())
        sensor.create_default_light(enable_shadows=bool(self._sunlight.size), direction=direction, color=(1.0,) * 3)
        sensor.set_ambient_light((0.0,) * 3, (0.0,) * 3)

    @property
    def images(self) -> dict[str, wp.array]:
        """Images that the sensor must render beside distance, shape and normal, by its names."""
        found = {"albedo_image": self._texture, "hdr_color_image": self._sunlight}
        return {name: image for name, image in found.items() if image.size}

    def launch(
        self, due: wp.array, pose: wp.array, rays: wp.array, distance: wp.array, shape: wp.array, normal: wp.array
    ) -> None:
        """Write the colours of the environments that are due; arguments as of the kernel."""
        inputs = [self.look, due, pose, rays, distance, shape, normal, self._texture, self._sunlight]
        inputs += [self._model.shape_color, self._model.shape_type, self.background, self._no_casters]
        wp.launch(color_pixels, dim=self.color.shape, inputs=inputs, outputs=[self.color])
