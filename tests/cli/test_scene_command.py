# SPDX-License-Identifier: Apache-2.0
"""Command ``stripe-newton scene``: previews, built files, names and errors."""

from __future__ import annotations

import colorsys
import math
from pathlib import Path

import newton
import numpy as np
import pytest
import torch
from PIL import Image
from pxr import Usd

from stripe_newton import registration
from stripe_newton.cli import main, scene_simulate
from stripe_newton.cli.progress import Progress
from stripe_newton.registration import register_scene, scene_class, scene_names
from stripe_newton.scene.scenery import add_scenery, read_scenery
from stripe_newton.specifications.scene_pictures import EYE_HEIGHT, ScenePictures
from stripe_newton.terrains.ground_usd import ground_prims, read_ground
from tests.helpers.small_wood import SmallWood

WOOD = "tests.helpers.small_wood:SmallWood"


def table_of(text: str) -> dict[str, str]:
    """The rows of a report."""
    return {line[:20].split("  ")[0]: line.split("  ")[-1].strip() for line in text.splitlines() if "  " in line}


def error_of(capsys, *args: str) -> str:
    capsys.readouterr()
    assert main(["scene", *args]) == 2
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err
    return captured.err + captured.out


def hues(picture: np.ndarray) -> int:
    """Number of hues, of twelve, with at least a hundredth of the pixels."""
    pixels = picture.reshape(-1, 3)[::17] / 255.0
    found = [colorsys.rgb_to_hsv(*p) for p in pixels]
    counts = np.bincount([int(h * 12) % 12 for h, s, _ in found if s > 0.12], minlength=12)
    return int((counts > 0.01 * len(pixels)).sum())


def model_of(stage: Usd.Stage) -> tuple[newton.ModelBuilder, np.ndarray]:
    builder = newton.ModelBuilder()
    add_scenery(builder, read_scenery(stage))
    ground = read_ground(ground_prims(stage)[0])
    builder.add_shape_heightfield(heightfield=ground.source)
    return builder, ground.source.colors


@pytest.fixture(scope="module")
def preview(tmp_path_factory):
    """Folder of the pictures, and what the command printed."""
    out = tmp_path_factory.mktemp("preview") / "new"
    with pytest.MonkeyPatch.context() as patch:
        lines: list[str] = []
        patch.setattr("builtins.print", lambda *a, **k: lines.append(" ".join(map(str, a))))
        args = [WOOD, "--seed", "3", "--size", "50", "30", "--count", "80", "--resolution", "240", "136"]
        assert main(["scene", "preview", *args, "--out", str(out)]) == 0
    return out, "\n".join(lines)


@pytest.mark.parametrize("name", ["birds_eye", "eye_level"])
def test_pictures_are_not_blank(preview, name):
    picture = np.asarray(Image.open(preview[0] / f"{name}.png"))
    assert picture.shape == (136, 240, 3)
    assert picture.std() > 25
    assert hues(picture) >= 3


def test_the_sky_is_at_the_top_and_fades_towards_the_horizon(preview):
    picture = np.asarray(Image.open(preview[0] / "birds_eye.png")).astype(int)
    for corner in (picture[:8, :8], picture[:8, -8:]):
        r, g, b = corner.reshape(-1, 3).mean(axis=0)
        assert b > g > r
        assert b > 150


def test_maps_show_every_map_that_is_not_even(preview, monkeypatch):
    from stripe_newton.specifications import scene_maps

    picture = np.asarray(Image.open(preview[0] / "maps.png").convert("RGB"))
    assert hues(picture) >= 4
    titles = []
    from matplotlib.figure import Figure

    save = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda f, p: (titles.extend(a.get_title() for a in f.axes), save(f, p)))
    scene = SmallWood(count=5).create(1)
    scene_maps.draw_maps(scene, preview[0] / "again.png")
    assert [t for t in titles if t] == ["height, seed 1", "10 instances", "slope", "moisture"]
    scene.terrain.maps["slope"] = np.zeros(3)
    with pytest.raises(ValueError, match=r"map 'slope': is \(3,\), must be two-dimensional"):
        scene_maps.draw_maps(scene, preview[0] / "bad.png")


def test_the_report_counts_what_was_made(preview):
    rows = table_of(preview[1])
    scene = SmallWood((50.0, 30.0), count=80).create(3)
    assert rows["trees"] == rows["stones"] == "80"
    assert rows["instances"] == "160"
    assert rows["prototypes"] == "2"
    assert rows["colliders"] == "161"
    faces = {i.mesh.name: sum(len(p.faces) for p in i.mesh.parts()) for i in scene.instances}
    ground = 2 * 50 * 30
    assert rows["triangles"] == f"{sum(faces.values()) + ground:,} unique, {80 * sum(faces.values()) + ground:,} shown"
    assert int(rows["peak memory"].removesuffix(" MB").replace(",", "")) > 50
    for text in ("terrain: ", "trees: ", "stones: ", "eye_level.png"):
        assert text in preview[1]


@pytest.mark.parametrize("suffix", ["usda", "usdc", "usd"])
def test_a_built_file_gives_the_same_model(tmp_path, capsys, suffix):
    path = tmp_path / "new" / f"wood.{suffix}"
    assert main(["scene", "build", WOOD, "--seed", "2", "--density", "1000", "--out", str(path)]) == 0
    rows = table_of(capsys.readouterr().out)
    assert rows["instances"] == "480"
    assert rows["file size"] == f"{path.stat().st_size / 1.0e6:.1f} MB"
    ours, colors = model_of(SmallWood(density=1000).create(2).stage)
    theirs, read = model_of(Usd.Stage.Open(str(path)))
    assert ours.shape_count == theirs.shape_count == 3 * 240 + 2 * 240 + 1
    assert ours.shape_type == theirs.shape_type
    assert len({id(s) for s in theirs.shape_source}) == len({id(s) for s in ours.shape_source})
    np.testing.assert_allclose(np.array(ours.shape_transform), np.array(theirs.shape_transform), atol=1e-6)
    np.testing.assert_allclose(colors, read)
    np.testing.assert_allclose(read[0, 0], (0.3, 0.1, 0.05), atol=1e-6)


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(tmp_path):
    files = []
    for index, seed in enumerate((5, 5, 6)):
        files.append(tmp_path / f"{index}.usda")
        assert main(["scene", "build", WOOD, "--seed", str(seed), "--count", "20", "--out", str(files[-1])]) == 0
    assert files[0].read_bytes() == files[1].read_bytes()
    assert files[0].read_bytes() != files[2].read_bytes()


def test_registered_scenes_are_found_by_name(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(registration, "_SCENES", {})
    register_scene("small_wood", WOOD)
    register_scene("small_wood", WOOD)  # a module that is imported twice
    register_scene("no_such_module", "nowhere.at_all:Class")
    assert scene_names() == ["no_such_module", "small_wood"]
    assert scene_class("small_wood") is SmallWood
    with pytest.raises(
        ValueError, match=r"scene 'small_wood': is registered already, as tests\.helpers\.small_wood:SmallWood"
    ):
        register_scene("small_wood", "elsewhere:Wood")
    assert main(["scene", "build", "small_wood", "--count", "3", "--out", str(tmp_path / "w.usda")]) == 0
    assert "did you mean small_wood?" in error_of(capsys, "preview", "smal_wood")
    assert "there are: " in error_of(capsys, "preview", "qqq")
    assert main(["scene", "--help"]) == 0
    assert "small_wood" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("args", "text"),
    [
        (["build", WOOD, "--out", "wood.obj"], "--out wood.obj: must end in .usd, .usda or .usdc"),
        (["build", WOOD, "--seed", "-1", "--out", "w.usd"], "--seed -1: must be at least 0"),
        (["build", WOOD, "--count", "3", "--density", "5", "--out", "w.usd"], "--density and --count: give one"),
        (["build", WOOD, "--count", "-3", "--out", "w.usd"], "count is -3, must be 0 or more"),
        (["build", WOOD, "--size", "-3", "5", "--out", "w.usd"], "must be two positive lengths"),
        (["build", "tests.helpers.small_wood:FixedWood", "--count", "3", "--out", "w.usd"],
         "FixedWood does not take --count; of these it takes --size"),
        (["build", "tests.helpers.small_wood:NeedsNumber", "--out", "w.usd"], "NeedsNumber needs number"),
        (["build", "tests.helpers.small_wood:Missing", "--out", "w.usd"], "has no 'Missing'"),
        (["build", "tests.helpers.small_wood:tree", "--out", "w.usd"], "must be a subclass of SceneSpec"),
        (["build", "stripe_newton.specifications:SceneSpec", "--out", "w.usd"], "SceneSpec is abstract"),
        (["build", "no_such.module:Wood", "--out", "w.usd"], "there is no module 'no_such.module'"),
        (["preview", WOOD, "--resolution", "5", "5"], "must be from 16 to 4096 pixels"),
        (["previw", WOOD], "did you mean preview?"),
    ],
)  # fmt: skip
def test_mistakes_are_told_before_anything_is_made(args, text, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert text in error_of(capsys, *args)
    assert list(tmp_path.iterdir()) == []


def test_the_camera_stands_clear_of_everything():
    scene = SmallWood((60.0, 60.0), count=300).create(1)
    eye, target = ScenePictures(scene, (64, 36), "cpu").view()
    ground = scene.terrain.ground
    assert eye[2] == pytest.approx(float(ground.height_at(eye[0], eye[1])) + EYE_HEIGHT)
    assert math.dist(eye, scene.terrain.origin) < 10.0
    ahead = (target - eye)[:2] / np.linalg.norm((target - eye)[:2])
    for tree in scene.terrain.placed["trees"]:
        away = np.array(tree.position[:2]) - eye[:2]
        assert np.linalg.norm(away) > 0.25 * tree.scale + 0.5
        if away @ ahead > 0.0 and np.linalg.norm(away - (away @ ahead) * ahead) < 0.3:
            assert away @ ahead > 1.0  # no trunk before the nose


def test_a_terminal_sees_a_bar_and_others_plain_lines(capsys, monkeypatch):
    with Progress() as progress:
        progress.step("a", "first", 1, 2)
        progress.step("a", "second", 2, 2)
    out = capsys.readouterr().out
    assert "\r" not in out
    assert [line.split(":")[0] for line in out.splitlines()] == ["first", "second"]
    assert list(progress.seconds) == ["a"]
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    progress = Progress()
    progress.step("a", "second", 2, 2)
    progress.__exit__(RuntimeError, RuntimeError(), None)
    out = capsys.readouterr().out
    assert f"[{'#' * 12}{' ' * 12}] second ..." in out
    assert "second: failed" in out


def test_things_in_a_thicket_and_over_the_edge_are_counted(monkeypatch):
    """More trunks within reach than there are slots are a warning: a look at a scene does not end by them."""
    monkeypatch.setattr(scene_simulate, "_SLOTS", 1)
    spec = SmallWood((12.0, 12.0), count=500)
    scene = spec.create(1)
    options = scene_simulate.Options(1, 2, 1.0, "none", Path("none.mp4"), (64, 36), "127.0.0.1", 8080, "cpu")
    lab = scene_simulate._build(spec, scene, options)
    walk = scene_simulate._Walk(scene, lab, options)
    walk.drop()

    def fall():
        for _ in range(6):
            lab.step()

    with pytest.warns(UserWarning, match="slots is 1"):
        fall()
    pose = torch.tensor([[0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 1.0]]).repeat(2, 1)
    for kind, (x, z) in {"box": (0.0, 5.0), "ball": (7.0, -3.0), "rod": (0.0, -3.0)}.items():
        pose[:, 0], pose[:, 2] = x, z
        lab.scene[kind].write_root_pose_to_sim(pose)
        lab.scene[kind].write_root_velocity_to_sim(torch.ones(2, 6))
    told = dict(walk.report())["things"]
    lab.close()
    assert told == "6 dropped at 2 places: 0 at rest, 2 over the edge, 2 below the ground"
