# SPDX-License-Identifier: Apache-2.0
"""Names of Isaac Lab's utilities: configs, math, noise, files."""

from .entries import Table, dialect, same

_DICTIONARIES = """class_to_dict convert_dict_to_backend print_dict replace_slices_with_strings
    replace_strings_with_slices update_class_from_dict"""
_STRINGS = """callable_to_string resolve_matching_names resolve_matching_names_values string_to_callable to_camel_case
    to_snake_case"""
_BUFFERS = "CircularBuffer DelayBuffer TimestampedBuffer"

NAMES: dict[str, Table] = {
    "isaaclab.envs.utils.io_descriptors": dialect(
        "io_descriptors",
        """generic_io_descriptor record_shape=record_nothing record_dtype=record_nothing
        record_joint_names=record_nothing record_body_names=record_nothing record_joint_shape=record_nothing
        record_joint_pos_offsets=record_nothing record_joint_vel_offsets=record_nothing""",
    ),
    "isaaclab.utils": dialect("configclass", "configclass")
    | dialect("strings", _STRINGS)
    | dialect("dictionaries", _DICTIONARIES)
    | dialect("buffers", _BUFFERS)
    | dialect("timer", "Timer"),
    "isaaclab.utils.buffers": dialect("buffers", _BUFFERS),
    "isaaclab.utils.types": dialect("env_types", "ArticulationActions"),
    "isaaclab.utils.assets": dialect(
        "files",
        """ISAACLAB_NUCLEUS_DIR ISAAC_NUCLEUS_DIR NUCLEUS_ASSET_ROOT_DIR NVIDIA_NUCLEUS_DIR check_file_path read_file
        retrieve_file_path""",
    ),
    "isaaclab.utils.dict": dialect("dictionaries", _DICTIONARIES),
    "isaaclab.utils.io": dialect("files", "load_torchscript_model"),
    "isaaclab.utils.modifiers": dialect(
        "modifiers",
        "DigitalFilter DigitalFilterCfg Integrator IntegratorCfg ModifierBase ModifierCfg bias clip scale",
    ),
    "isaaclab.utils.noise": same(
        "stripe_newton.noise",
        """AdditiveUniformNoiseCfg=UniformNoiseCfg AdditiveGaussianNoiseCfg=GaussianNoiseCfg
        ConstantBiasNoiseCfg=ConstantNoiseCfg ConstantNoiseCfg GaussianNoiseCfg NoiseCfg UniformNoiseCfg constant_noise
        gaussian_noise uniform_noise""",
    )
    | dialect("noise", "NoiseModel NoiseModelCfg NoiseModelWithAdditiveBias NoiseModelWithAdditiveBiasCfg"),
    "isaaclab.utils.string": dialect("strings", _STRINGS),
    "isaaclab.utils.version": dialect("dictionaries", "get_isaac_sim_version"),
}

ALIASES: dict[str, str] = {
    "isaaclab.utils.math": "stripe_newton.isaaclab.math",
}
