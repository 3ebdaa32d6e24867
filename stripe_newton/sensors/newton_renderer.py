# SPDX-License-Identifier: Apache-2.0
"""Newton renderer: pictures of a camera by Newton's camera sensor, for what the own renderer does not draw."""

from __future__ import annotations

import newton
import numpy as np
import warp as wp
from newton.sensors import SensorCamera

from stripe_kernels.box_normals import fill_box_normals
from stripe_kernels.sensors import camera as kernels
from stripe_kernels.sensors.camera_shading import TILE_HEIGHT, TILE_WIDTH
from stripe_newton.sim import Simulation

from .camera_colors import CameraColors
from .camera_renderer import CameraImages
from .pinhole import PinholeIntrinsics

__all__ = ["NewtonRenderer", "has_textures"]

_NOTHING = 0xFFFFFFFF


def has_textures(model: newton.Model) -> bool:
    """Whether a mesh of a model has a texture."""
    return any(isinstance(s, newton.Mesh) and s.texture is not None for s in model.shape_source)


class NewtonRenderer:
    """Rays of Newton's sensor, and the kernels that make its output a camera's images.

    Attributes:
        sensor: Newton's sensor.
    """

    def __init__(
        self,
        sim: Simulation,
        lens: PinholeIntrinsics,
        depths: tuple[float, float],
        images: CameraImages,
        colors: CameraColors | None,
        missing: float,
        shadows: bool,
    ):
        """Make sensor, rays and the images between.

        Args:
            sim: The simulation, built.
            lens: The lens.
            depths: Nearest and farthest depth that is seen [m].
            images: Images to write.
            colors: Light and air, if colours are among the images.
            missing: Depth where there is nothing [m].
            shadows: Whether the sun casts shadows.
        """
        self._sim, self._images, self._colors = sim, images, colors
        self._near, self._far, self._missing = float(depths[0]), float(depths[1]), missing
        shapes = [image.shape for image in vars(images).values() if image.size]
        self._count, height, width = self._shape = shapes[0]
        with wp.ScopedDevice(sim.device):
            self._world = wp.zeros(self._count, dtype=int)
            self._make_rays(lens, width, height)
            colored = self._shape if colors is not None else (0, 0, 0)
            # Colours need lengths, normals and shapes, whether the config asks for those or not.
            self._lengths = images.length if images.length.size else wp.zeros(colored, dtype=float)
            self._normals = images.normals if images.normals.size else wp.zeros(colored, dtype=wp.vec3)
            needs_shapes = bool(self._normals.size) and not images.shape.size
            self._shapes = wp.full(self._shape, _NOTHING, dtype=wp.uint32) if needs_shapes else images.shape
            self.sensor = self._make_sensor(shadows)

    def _make_rays(self, lens: PinholeIntrinsics, width: int, height: int) -> None:
        """Rays from the near plane through the middles of the pixels, in the frame that looks along -z."""
        pixels = lens.pixel_directions(width, height) * (1.0, -1.0, -1.0)
        length = np.linalg.norm(pixels, axis=-1)
        # Pairs of start and direction: a ray starts at the near plane, so that nothing before it is seen.
        rays = np.stack([pixels * self._near, pixels / length[..., None]], axis=2)
        self._rays = wp.array(rays[:, :, None].astype(np.float32), dtype=wp.vec3)
        # The far plane is flat: rays to the corners of the image are longer than the one along the axis.
        self._slant = wp.array((1.0 / length).astype(np.float32), dtype=float)
        self._reach = float(self._far * length.max())

    def _make_sensor(self, shadows: bool) -> SensorCamera:
        # A negative depth, which nothing has, marks pixels that show nothing.
        clear = SensorCamera.ClearData(clear_depth=-1.0, clear_shape_index=_NOTHING)
        # Loading textures takes time and memory, and the kernel is another one: only where a mesh has one.
        textured = has_textures(self._sim.model)
        config = SensorCamera.RenderConfig(
            enable_textures=textured,
            enable_backface_culling=False,
            enable_ambient_lighting=False,
            enable_shadows=shadows,
            max_distance=self._reach,
            # Rays of a warp in one picture and near each other, rather than one of each of 32 pictures.
            render_order=SensorCamera.RenderOrder.TILED,
            tile_width=TILE_WIDTH,
            tile_height=TILE_HEIGHT,
        )
        sensor = SensorCamera(
            self._sim.model, default_clear_data=clear, default_render_config=config, load_textures=textured
        )
        if self._colors is not None:
            self._colors.set_lights(sensor)
        return sensor

    def launch(self, due: wp.array, camera: wp.array) -> None:
        """Render; launches kernels only.

        Args:
            due: Environments that take a picture, bool, shape ``(num_envs,)``; the others keep theirs.
            camera: Poses of the cameras in the world, looking along -z [m], shape ``(num_envs,)``.
        """
        state, model, images = self._sim.state, self._sim.model, self._images
        idle = int(SensorCamera.WorldRenderFlag.DISABLE_PRESERVE)
        # Environments whose image is not due are switched off by their world index, and keep their pixels: the sensor
        # is launched for all in every step, so that one graph serves steps with and without images.
        wp.launch(kernels.choose_worlds, dim=self._count, inputs=[due, idle], outputs=[self._world])
        model.bvh_refit_shapes(state)  # the bodies have moved since the last image
        self.sensor.update(
            state,
            camera,
            self._rays,
            forward_depth_image=_or_none(images.plane),
            depth_image=_or_none(self._lengths),
            normal_image=_or_none(self._normals),
            shape_index_image=_or_none(self._shapes),
            world_indices=self._world,
            **({} if self._colors is None else self._colors.images),
        )
        if self._normals.size:
            inputs = [camera, self._rays, self._shapes, model.shape_type, model.shape_scale, model.shape_body]
            inputs += [model.shape_transform, state.body_q]
            wp.launch(fill_box_normals, dim=self._shape, inputs=inputs, outputs=[self._normals])
        if self._colors is not None:
            self._colors.launch(due, camera, self._rays, self._lengths, self._shapes, self._normals)
        if images.plane.size or images.length.size:
            inputs = [due, self._slant, self._near, self._far, self._missing]
            wp.launch(kernels.clip_depth, dim=self._shape, inputs=inputs, outputs=[images.plane, images.length])

    def describe(self) -> str:
        """The renderer in a few words."""
        return "Newton's sensor"


def _or_none(array: wp.array) -> wp.array | None:
    return array if array.size else None
