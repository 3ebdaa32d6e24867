# SPDX-License-Identifier: Apache-2.0
"""Camera: colour, depth, normals and segmentation of every environment."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, ClassVar

import newton
import numpy as np
import torch
import warp as wp

from stripe_kernels.picture_light import Look
from stripe_kernels.sensors import camera as kernels
from stripe_kernels.sensors.camera_shading import CameraLight
from stripe_kernels.sensors.camera_shapes import Lens
from stripe_newton.configclass import MISSING, ConfigError, configclass
from stripe_newton.noise import NoiseCfg, NoiseModelCfg
from stripe_newton.value_types import NonNegativeFloat, NonNegativeInt, PositiveInt, UnitFloat

from .camera_colors import CameraColors
from .camera_data import FROM_WORLD, CameraData
from .camera_labels import shape_labels
from .camera_renderer import CameraImages, CameraRenderer, visible_shapes, why_not_rendered
from .clock import SensorClock
from .depth_noise import DepthNoiseCfg
from .image_corruption import ImageCorruption
from .newton_renderer import NewtonRenderer, has_textures
from .pinhole import PinholeIntrinsics
from .prim_paths import Frame
from .prim_paths import OffsetCfg as FrameOffsetCfg
from .ray_caster_targets import choose_visible, path_problems
from .sensor_base import SensorBase, SensorBaseCfg
from .sensor_mount import find_mount
from .warp_struct import field_values

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

__all__ = ["DATA_TYPES", "Camera", "CameraCfg", "PinholeCameraCfg", "TiledCamera", "TiledCameraCfg"]

_IMAGES = ("rgb", "distance_to_image_plane", "distance_to_camera", "normals")
_LABELS = ("semantic_segmentation", "instance_segmentation", "instance_id_segmentation")
_LIGHT = ("to_sun", "sun", "sky", "ground")
_NOT_SAVED = ("rgb", "mount", "default_mount", *_LIGHT, *(f"default_{name}" for name in _LIGHT))
"""Fields of the struct that are saved as other arrays, or never change."""
_NOTHING = 0xFFFFFFFF
"""Shape index of a pixel that shows no shape."""

DATA_TYPES = {
    "rgb": "rgb",
    "rgba": "rgb",
    "depth": "distance_to_image_plane",
    "distance_to_image_plane": "distance_to_image_plane",
    "distance_to_camera": "distance_to_camera",
    "normals": "normals",
    "semantic_segmentation": "semantic_segmentation",
    "instance_segmentation": "instance_segmentation",
    "instance_segmentation_fast": "instance_segmentation",
    "instance_id_segmentation": "instance_id_segmentation",
    "instance_id_segmentation_fast": "instance_id_segmentation",
}
"""Data types that a config may ask for, and the field of ``CameraData`` that holds each."""


@configclass
class PinholeCameraCfg(PinholeIntrinsics):
    """Lens, film, and the depths that are seen. Everything is in focus."""

    clipping_range: tuple[float, float] = (0.01, 1.0e3)
    """Depths along the optical axis between which things are seen [m]."""
    focus_distance: float = 400.0
    """Ignored: everything is in focus."""
    f_stop: float = 0.0
    """Ignored: everything is in focus."""

    IGNORED: ClassVar[dict[str, str]] = dict.fromkeys(("focus_distance", "f_stop"), "everything is in focus")

    def problems(self) -> Iterator[tuple[str, str]]:
        bounds = self.clipping_range
        if not 0.0 <= bounds[0] < bounds[1]:
            yield "clipping_range", f"is {bounds}, must be (near, far) with 0 <= near < far [m]"


def _camera(cfg: CameraCfg) -> Camera:
    return Camera(cfg)


@configclass
class CameraCfg(SensorBaseCfg):
    """A pinhole camera in every environment, rendered for all of them at once.

    ``prim_path`` names a body, or a name of the camera's own below a body or below the environment, such as
    ``{ENV_REGEX_NS}/Robot/head/camera`` or ``{ENV_REGEX_NS}/Camera``.
    """

    @configclass
    class OffsetCfg(FrameOffsetCfg):
        """Pose of the camera in the frame of its body, or of the environment."""

        convention: str = "ros"
        """Frame that ``rot`` turns: ``"ros"`` looks along z with y down, ``"opengl"`` along -z with y up,
        ``"world"`` along x with z up."""

        def problems(self) -> Iterator[tuple[str, str]]:
            yield from super().problems()
            if self.convention not in ("ros", "opengl", "world"):
                yield "convention", f"is {self.convention!r}, must be 'ros', 'opengl' or 'world'"

    class_type: Callable[..., SensorBase] | None = _camera
    """Class that the scene makes of this config."""
    offset: OffsetCfg = OffsetCfg()
    """Pose of the camera in the frame of its body, or of the environment."""
    spawn: PinholeCameraCfg = PinholeCameraCfg()
    """Lens and film."""
    width: PositiveInt = MISSING
    """Pixels in a row."""
    height: PositiveInt = MISSING
    """Pixels in a column."""
    data_types: Sequence[str] = ("rgb",)
    """Images that are rendered, of :data:`DATA_TYPES`."""
    mesh_prim_paths: Sequence[str] = ()
    """Prims that are seen, with all below them, such as ``/World/ground`` or ``{ENV_REGEX_NS}/Box_.*``; expressions are
    allowed. The camera looks through everything else. Empty for all that is visible."""
    depth_clipping_behavior: str = "none"
    """Depth of what is not seen: ``"none"`` infinity, ``"max"`` the far bound, ``"zero"`` 0."""
    background_color: tuple[UnitFloat, UnitFloat, UnitFloat] | None = None
    """Colour where there is nothing, sRGB, each from 0 to 1. None: the sky that ``env.render()`` shows."""
    shadows: bool = False
    """Whether the sun casts shadows: a second ray a pixel."""
    mesh_detail: NonNegativeFloat = 0.5
    """Largest distance by which the surface of a mesh may be moved in the picture to draw fewer triangles [px]. The
    package's own renderer draws meshes of 1000 triangles and more coarser the farther they are away, and visual meshes
    of one body as one. 0: each as it is."""
    renderer: str = "auto"
    """``"auto"``: the package's own renderer where it draws what there is, and Newton's camera sensor for textures,
    particles and the like. ``"newton"``: Newton's sensor."""
    noise: NoiseCfg | NoiseModelCfg | DepthNoiseCfg | None = None
    """Noise of depths and distances [m]; of colours, put it on the observations. What is not seen stays so."""
    delay: NonNegativeInt | tuple[NonNegativeInt, NonNegativeInt] = 0
    """Age of pose and images, in images; a pair is the range from which each episode draws it."""
    debug_vis: bool = False
    """Ignored: a camera is not drawn; the live view shows its pictures."""
    IGNORED: ClassVar[dict[str, str]] = {"debug_vis": "a camera is not drawn; the live view shows its pictures"}

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        wrong = [t for t in self.data_types if t not in DATA_TYPES]
        if wrong or not self.data_types:
            yield "data_types", f"has {', '.join(map(repr, wrong)) or 'none'}, must be of {', '.join(DATA_TYPES)}"
        if self.depth_clipping_behavior not in ("none", "max", "zero"):
            yield "depth_clipping_behavior", f"is {self.depth_clipping_behavior!r}, must be 'none', 'max' or 'zero'"
        if self.renderer not in ("auto", "newton"):
            yield "renderer", f"is {self.renderer!r}, must be 'auto' or 'newton'"
        yield from path_problems(self.mesh_prim_paths)
        if self.history_length:
            yield "history_length", "is not kept by cameras"
        if self.delay_range[0] > self.delay_range[1]:
            yield "delay", f"is {self.delay}, must be (least, most) with least <= most [images]"

    @property
    def delay_range(self) -> tuple[int, int]:
        """Least and largest age of the images, in images."""
        return (self.delay, self.delay) if isinstance(self.delay, int) else (self.delay[0], self.delay[1])


@configclass
class TiledCameraCfg(CameraCfg):
    """A :class:`CameraCfg` by Isaac Lab's other name: every camera is rendered for all environments at once."""


class Camera(SensorBase):
    """A camera in every environment; it takes its image after the reset of a step, before the observations.

    It sees every visible shape of its environment and of what all share, colliders or not, unless the config names some
    by ``mesh_prim_paths``.

    Attributes:
        clock: Says when it takes an image.
        renderer: What renders: :class:`CameraRenderer` or :class:`NewtonRenderer`.
        colors: Light and air of its colours; None if it renders none.
        poses_opengl: Poses in the world of frames that look along -z with y up, as renderers take them.
    """

    cfg: CameraCfg
    data: CameraData
    struct: kernels.CameraData

    def prepare(self, sim: Simulation, template: newton.ModelBuilder, static: newton.ModelBuilder) -> None:
        from scipy.spatial.transform import Rotation  # here, as it takes long to import

        self._where = f"{type(self).__name__} '{self.cfg.prim_path}'"
        offset = self.cfg.offset
        turn = Rotation.from_quat(offset.rot_xyzw) * Rotation.from_quat(FROM_WORLD[offset.convention]).inv()
        mount = find_mount(template, self.cfg.prim_path, self._where, own_prim=True)
        pose = wp.transform(wp.vec3(*offset.pos), wp.quat(*map(float, turn.as_quat())))
        self._mount = Frame(mount.name, mount.body, mount.pose * pose)

    def initialize(self, sim: Simulation) -> None:
        super().initialize(sim)
        cfg, shape = self.cfg, (self.num_envs, self.cfg.height, self.cfg.width)
        with wp.ScopedDevice(sim.device):
            remembers = cfg.noise is not None or cfg.delay_range[1] > 0
            self.clock = SensorClock(sim, cfg.update_period, self._where, observed=True, remembers=remembers)
            self._setup = self._make_setup(sim)
            self.poses_opengl = wp.zeros(self.num_envs, dtype=wp.transform)
            self._make_images(sim, shape)
            self._hand_out()
            self.renderer = self._make_renderer(sim)
        self.data = self._make_data()

    def _make_setup(self, sim: Simulation) -> kernels.CameraSetup:
        setup = kernels.CameraSetup()
        setup.body_pose, setup.num_bodies = sim.state.body_q, sim.template.body_count
        setup.body = self._mount.body
        setup.env_origin = wp.array(sim.env_origins, dtype=wp.vec3)
        setup.mount, self._default_mount = (
            wp.full(self.num_envs, value=self._mount.pose, dtype=wp.transform) for _ in range(2)
        )
        setup.due = self.clock.due
        return setup

    def _make_images(self, sim: Simulation, shape: tuple[int, int, int]) -> None:
        """Allocate what is rendered into; data types that the config does not ask for are empty arrays."""
        wanted = {DATA_TYPES[name] for name in self.cfg.data_types}
        self._raw = raw = kernels.CameraData()
        raw.pos_w, raw.quat_w_world = (wp.zeros(self.num_envs, dtype=t) for t in (wp.vec3, wp.quat))
        self._absent = [name for name in (*_IMAGES, *_LABELS) if name not in wanted]
        self._color = wp.zeros(shape if "rgb" in wanted else (0, 0, 0), dtype=wp.uint32)
        raw.rgb = wp.from_torch(_bytes(self._color)[..., :3], dtype=wp.uint8)
        for name in (*_IMAGES[1:], *_LABELS):
            kind = wp.vec3 if name == "normals" else wp.int32 if name in _LABELS else wp.float32
            # Kernels take all of them: what is not wanted is an empty array rather than None.
            array = wp.zeros(shape if name in wanted else (0, 0, 0), dtype=kind)
            if kind is wp.float32:
                array.fill_(math.inf)
            setattr(raw, name, array)
        self._info: dict[str, dict[int, str]] = {}
        self._labels: dict[str, wp.array] = {}
        for name in (n for n in _LABELS if n in wanted):
            numbers, self._info[name] = shape_labels(self._scene, sim.model, name)
            self._labels[name] = wp.array(numbers, dtype=int)
        self._shapes = wp.full(shape if self._labels else (0, 0, 0), value=_NOTHING, dtype=wp.uint32)

    def _hand_out(self) -> None:
        """Make what terms and users read: the same arrays, unless noise or delay lies between."""
        cfg, raw = self.cfg, self._raw
        self._missing = {"none": math.inf, "max": cfg.spawn.clipping_range[1], "zero": 0.0}[cfg.depth_clipping_behavior]
        self._corruption = corruption = ImageCorruption(self.num_envs, cfg.delay_range, self.device, self._where)
        self.struct = data = kernels.CameraData()
        data.mount, data.default_mount = self._setup.mount, self._default_mount
        # Poses are delayed with the images: a policy is to see from where an image was taken.
        for name in ("pos_w", "quat_w_world", *_IMAGES[1:], *_LABELS):
            array = getattr(raw, name)
            if cfg.noise is not None and name.startswith("distance_to") and array.size:
                array = corruption.noise(name, array, cfg.noise, self._missing, f"{self._where}.noise")
            setattr(data, name, corruption.lag(name, array))
        self._seen_color = corruption.lag("color", self._color)
        self._rgba = _bytes(self._seen_color)
        data.rgb = wp.from_torch(self._rgba[..., :3], dtype=wp.uint8)

    def _make_renderer(self, sim: Simulation) -> CameraRenderer | NewtonRenderer:
        cfg, raw, model = self.cfg, self._raw, sim.model
        images = CameraImages(
            self._color, raw.distance_to_image_plane, raw.distance_to_camera, raw.normals, self._shapes
        )
        fx, _, cx, _, fy, cy = map(float, cfg.spawn.matrix(cfg.width, cfg.height).ravel()[:6])
        # With noise a miss is infinite here, which noise leaves alone; its own value is filled in afterwards.
        missing = self._missing if cfg.noise is None else math.inf
        colors: CameraColors | None = None
        if self._color.size:
            # Before the sensor is made, which reads the meshes: colours give them their creases.
            colors = CameraColors(sim, self._color, fy, has_textures(model), cfg.shadows, cfg.background_color)
        self.colors, light = colors, self._make_light(colors)
        depths = cfg.spawn.clipping_range
        seen = np.zeros(model.shape_count, dtype=bool)
        seen[visible_shapes(model)] = True
        if cfg.mesh_prim_paths:
            seen = choose_visible(model, cfg.mesh_prim_paths, seen, self._where)
        why = why_not_rendered(model, np.flatnonzero(seen), colors is not None)
        reason = "renderer is 'newton'" if cfg.renderer == "newton" else why
        if reason and cfg.mesh_prim_paths:
            problem = f"cannot choose what is seen, as pictures are those of Newton's sensor: {reason}"
            raise ConfigError([f"{self._where}.mesh_prim_paths: {problem}; leave it empty"])
        if reason:
            text = f"one light for all environments, as Newton's sensor renders: {reason}"
            self.unavailable |= dict.fromkeys(_LIGHT, text) if colors is not None else {}
            return NewtonRenderer(sim, cfg.spawn, depths, images, colors, missing, cfg.shadows)
        lens = Lens()
        lens.fx, lens.fy, lens.cx, lens.cy, lens.near, lens.far = fx, fy, cx, cy, *map(float, depths)
        look, background = (Look(), 0) if colors is None else (colors.look, colors.background)
        terrain = self._scene.terrain.struct if self._scene.terrain is not None else None
        return CameraRenderer(
            model,
            sim.state,
            lens,
            images,
            look,
            light,
            missing,
            background,
            cfg.shadows,
            terrain,
            cfg.mesh_detail,
            seen,
        )

    def _make_light(self, colors: CameraColors | None) -> CameraLight:
        """Light of each environment, that of the scene to begin with; empty without colours."""
        light = CameraLight()
        for name in _LIGHT:
            value = wp.vec3(0.0) if colors is None else wp.vec3(*map(float, getattr(colors.lighting, name)))
            count = 0 if colors is None else self.num_envs
            for prefix in ("", "default_"):
                setattr(self.struct, prefix + name, wp.full(count, value=value, dtype=wp.vec3))
            setattr(light, name, getattr(self.struct, name))
        if colors is None:
            self.unavailable |= dict.fromkeys(_LIGHT, "it renders no colours; add 'rgb' to data_types")
        return light

    def _make_data(self) -> CameraData:
        cfg, data = self.cfg, CameraData(self.struct, self._absent)
        matrix = torch.as_tensor(cfg.spawn.matrix(cfg.width, cfg.height), dtype=torch.float32, device=self.device)
        data.intrinsic_matrices = matrix.repeat(self.num_envs, 1, 1)
        data.image_shape = cfg.height, cfg.width
        data.output, data.info = {}, {}
        for name in cfg.data_types:
            values = self._rgba if name == "rgba" else getattr(data, DATA_TYPES[name])
            data.output[name] = values if values.ndim == 4 else values.unsqueeze(-1)
            data.info[name] = {"idToLabels": self._info[DATA_TYPES[name]]} if DATA_TYPES[name] in _LABELS else {}
        return data

    # -- what is known of it

    def why_not_regenerable(self, name: str, ground: int) -> str:
        return f"the camera '{name}' sees the meshes of the scene as they were built; leave it out"

    @property
    def body_names(self) -> list[str]:
        return [self._mount.name]

    @property
    def arrays(self) -> dict[str, wp.array]:
        """Arrays that persist from step to step, by name; images only where some steps take none."""
        light = {f"light.{name}": array for name in _LIGHT if (array := getattr(self.struct, name)).size}
        kept = {"mount": self._setup.mount} | light | self.clock.arrays | self._corruption.arrays
        if self.clock.period == 1:
            return kept
        seen = {name: value for name, value in field_values(self.struct).items() if name not in _NOT_SAVED}
        return kept | seen | ({"color": self._seen_color.view(wp.int32)} if self._seen_color.size else {})

    def describe(self) -> str:
        """The camera in one line."""
        size, types = f"{self.cfg.width} x {self.cfg.height}", ", ".join(self.cfg.data_types)
        return f"{size} on '{self._mount.name}': {types}; {self.renderer.describe()}"

    def image(self, data_type: str) -> wp.array:
        """The array that holds a data type; ``rgba`` is none.

        Raises:
            KeyError: if it is not rendered; the message says what is.
        """
        there = [name for name in self.cfg.data_types if name != "rgba"]
        if data_type not in there:
            raise KeyError(f"'{data_type}' is not among the data_types that the camera renders: {', '.join(there)}")
        return getattr(self.struct, DATA_TYPES[data_type])

    # -- where it is

    def set_world_poses(
        self,
        positions: torch.Tensor | None = None,
        orientations: torch.Tensor | None = None,
        env_ids: Sequence[int] | torch.Tensor | None = None,
        convention: str = "ros",
    ) -> None:
        """Move a camera that is fixed to the environment; the next image is taken from there.

        Args:
            positions: In the world [m], shape ``(n, 3)``; default as they are.
            orientations: Quaternions (x, y, z, w) of the convention's frame, shape ``(n, 4)``; default as they are.
            env_ids: Environments, default all.
            convention: ``"ros"``, ``"opengl"`` or ``"world"``.

        Raises:
            ConfigError: if a body carries it, or for an unknown convention.
        """
        if self._mount.body >= 0:
            raise ConfigError([f"{self._where}: body '{self._mount.name}' carries it, it goes where that goes"])
        from scipy.spatial.transform import Rotation  # see above

        if convention not in FROM_WORLD:
            raise ConfigError([f"convention: is {convention!r}, must be one of {', '.join(FROM_WORLD)}"])
        mount, origins = wp.to_torch(self._setup.mount), wp.to_torch(self._setup.env_origin)
        rows = slice(None) if env_ids is None else env_ids
        if positions is not None:
            mount[rows, :3] = torch.as_tensor(positions, dtype=torch.float32, device=self.device) - origins[rows]
        if orientations is not None:
            own = Rotation.from_quat(torch.as_tensor(orientations).cpu().numpy())
            turn = own * Rotation.from_quat(FROM_WORLD[convention]).inv()
            mount[rows, 3:] = torch.as_tensor(turn.as_quat(), dtype=torch.float32).to(self.device)

    def set_world_poses_from_view(
        self, eyes: torch.Tensor, targets: torch.Tensor, env_ids: Sequence[int] | torch.Tensor | None = None
    ) -> None:
        """Put a camera that is fixed to the environment at ``eyes`` and look at ``targets``, z up.

        Args:
            eyes: Positions in the world [m], shape ``(n, 3)``.
            targets: Points in the middle of the picture [m], shape ``(n, 3)``.
            env_ids: Environments, default all.
        """
        from scipy.spatial.transform import Rotation  # see above

        forward = (torch.as_tensor(targets) - torch.as_tensor(eyes)).double().cpu().numpy()
        yaw, flat = np.arctan2(forward[:, 1], forward[:, 0]), np.hypot(forward[:, 0], forward[:, 1])
        turn = Rotation.from_euler("ZY", np.stack([yaw, -np.arctan2(forward[:, 2], flat)], axis=1)).as_quat()
        self.set_world_poses(eyes, torch.as_tensor(turn), env_ids, "world")

    # -- what a step launches

    def launch_measured(self) -> None:
        self.clock.count()

    def launch_reset(self, env_mask: wp.array) -> None:
        self.clock.restart(env_mask)
        self._corruption.restart(env_mask)

    def launch_observed(self) -> None:
        aim = [self._setup, wp.quat(*FROM_WORLD["opengl"])]
        wp.launch(kernels.aim_cameras, dim=self.num_envs, inputs=aim, outputs=[self._raw, self.poses_opengl])
        self.renderer.launch(self.clock.due, self.poses_opengl)
        dim = (self.num_envs, self.cfg.height, self.cfg.width)
        for name, labels in self._labels.items():
            inputs = [self.clock.due, self._shapes, labels]
            wp.launch(kernels.label_shapes, dim=dim, inputs=inputs, outputs=[getattr(self._raw, name)])
        self._corruption.launch(self.clock.due)
        self.clock.settle()


def _bytes(color: wp.array) -> torch.Tensor:
    """Packed colours as bytes, the same memory, shape ``(num_envs, height, width, 4)``."""
    return wp.to_torch(color.view(wp.int32)).view(torch.uint8).view(*color.shape, 4)


TiledCamera = Camera
"""Isaac Lab's name of a camera that is rendered for all environments at once, as every :class:`Camera` is."""
