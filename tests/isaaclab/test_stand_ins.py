# SPDX-License-Identifier: Apache-2.0
"""Stand-ins of the Isaac Lab dialect: classes, functions and constants, inert or refused."""

import pytest

from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.isaaclab.stand_ins import stand_in, with_ignored_fields


@configclass
class _Holder:
    part: object = None


def test_an_inert_class_takes_any_field_and_is_valid():
    part = stand_in("PhysxCfg", "inert", "it is of PhysX")(bounce_threshold_velocity=0.2)
    assert type(part).InitialStateCfg(pos=1).pos == 1
    assert part.replace(a=1).bounce_threshold_velocity == 0.2
    _Holder(part=part).validate()


def test_a_refused_class_makes_a_config_invalid():
    part = stand_in("MultirotorCfg", "refused", "thrusters are not simulated")(mass=1.0)
    with pytest.raises(ConfigError, match="MultirotorCfg is not supported: thrusters are not simulated"):
        _Holder(part=part).validate()
    with pytest.raises(AttributeError, match="MultirotorCfg is not supported: thrusters are not simulated"):
        part.rotor_count  # noqa: B018


def test_a_config_derived_from_a_refused_class_is_refused():
    base = stand_in("MimicEnvCfg", "refused", "there is no mimic")

    class Derived(base):
        steps: int = 3

    cfg = configclass(Derived)(steps=4)
    assert cfg.steps == 4
    with pytest.raises(ConfigError, match="MimicEnvCfg is not supported"):
        cfg.validate()


def test_a_refused_function_raises_and_an_inert_one_does_nothing():
    with pytest.raises(NotImplementedError, match="'convert_usd_to_urdf' is not supported: no converter"):
        stand_in("convert_usd_to_urdf", "refused", "no converter")("robot.usd")
    assert stand_in("enable_extension", "inert", "no application")("omni.kit") is None


def test_a_constant_takes_fields_at_any_depth():
    marker = stand_in("FRAME_MARKER_CFG", "inert", "not drawn")
    marker.markers["frame"].scale = (0.1, 0.1, 0.1)
    assert marker.replace(prim_path="/Visuals").markers["frame"].scale == (0.1, 0.1, 0.1)


def test_fields_without_effect_load_and_warn():
    more = with_ignored_fields(_Holder, (("physx", "it is of PhysX"), ("part", "never")))
    assert more is with_ignored_fields(_Holder, (("physx", "it is of PhysX"), ("part", "never")))
    more(part=1).validate()
    with pytest.warns(UserWarning, match="_Holder.physx has no effect: it is of PhysX"):
        more(part=1, physx=2).validate()
    assert with_ignored_fields(_Holder, (("part", "never"),)) is _Holder
