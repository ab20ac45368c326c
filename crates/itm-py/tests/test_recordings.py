"""Recordings, cameras and trajectories: what needs no graphics adapter."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import itm_slam


def test_a_recording_is_a_sequence_of_frames(recording: itm_slam.Recording) -> None:
    assert (len(recording), recording.name, recording.format) == (10, "room", "tum")
    assert recording.has_colour and recording.has_timestamps and recording.has_gyroscope
    frames = list(recording)
    assert [frame.index for frame in frames] == list(range(10))
    frame = frames[3]
    assert frame.depth.dtype == np.float32 and frame.depth.shape == (120, 160)
    assert frame.raw_depth is not None and frame.raw_depth.dtype == np.uint16
    assert frame.colour is not None and frame.colour.shape == (120, 160, 3)
    assert frame.pose is not None and frame.pose.shape == (4, 4)
    assert frame.gyroscope.shape[1] == 4
    assert frame.seconds == pytest.approx(frame.timestamp * 1e-9)
    assert np.allclose(frame.depth, frame.raw_depth / 5000, atol=1e-6)
    assert np.array_equal(recording[-7].depth, frame.depth)
    assert frame.depth is frame.depth and not frame.depth.flags.writeable
    assert [f.index for f in recording.frames(4, 6)] == [4, 5]


def test_frames_that_are_not_there(recording: itm_slam.Recording) -> None:
    for bad in [10, -11]:
        with pytest.raises(IndexError, match=f"frame {bad} .* 10"):
            recording[bad]
    with pytest.raises(IndexError, match="3 to 11 .* has 10"):
        recording.frames(3, 11)


def test_a_frame_that_cannot_be_read_is_told_and_the_next_ones_follow(room: Path, tmp_path: Path) -> None:
    copy = tmp_path / "room"
    shutil.copytree(room, copy)
    spoilt = sorted((copy / "depth").iterdir())[4]
    spoilt.write_bytes(spoilt.read_bytes()[:100])
    frames = iter(itm_slam.open(copy))
    assert [next(frames).index for _ in range(4)] == [0, 1, 2, 3]
    with pytest.raises(itm_slam.RecordingError, match="frame 4"):
        next(frames)
    assert [frame.index for frame in frames] == [5, 6, 7, 8, 9]
    skipping = itm_slam.open(copy).frames(skip_unreadable=True)
    assert len(list(skipping)) == 9 and len(skipping.skipped) == 1 and "frame 4" in skipping.skipped[0]


def test_what_is_no_recording(tmp_path: Path) -> None:
    with pytest.raises(itm_slam.RecordingError, match="does not exist"):
        itm_slam.open(tmp_path / "nowhere")
    with pytest.raises(itm_slam.Error, match="no known format"):
        itm_slam.open(tmp_path)
    with pytest.raises(ValueError, match="there are tum"):
        itm_slam.open(tmp_path, format="tun")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="topics"):
        itm_slam.open(tmp_path, topics=3)  # type: ignore[arg-type]


def test_cameras(tmp_path: Path) -> None:
    camera = itm_slam.Intrinsics(640, 480, 525.0, 525.0, 319.5, 239.5)
    assert camera == itm_slam.Intrinsics(640, 480, 525.0, 525.0, 319.5, 239.5)
    matrix: list[list[float]] = [[525, 0, 319.5], [0, 525, 239.5], [0, 0, 1]]
    assert np.array_equal(camera.matrix, matrix)
    calibration = itm_slam.Calibration(camera, depth_scale=0.0002, colour_distortion=[0.1, 0.0, 0.0, 0.0, 0.0])
    calibration.save(tmp_path / "calibration.txt")
    assert itm_slam.Calibration.load(tmp_path / "calibration.txt") == calibration
    assert calibration.depth_distortion is None and calibration.disparity is None
    with pytest.raises(itm_slam.CalibrationError, match="fx"):
        itm_slam.Calibration(itm_slam.Intrinsics(640, 480, 0.0, 525.0, 319.5, 239.5))
    with pytest.raises(ValueError, match="4, 5 or 8"):
        itm_slam.Calibration(camera, depth_distortion=[0.1])
    with pytest.raises(ValueError, match="rigid motion"):
        itm_slam.Calibration(camera, colour_from_depth=2 * np.eye(4))
    with pytest.raises(itm_slam.CalibrationError, match="exist|cannot"):
        itm_slam.Calibration.load(tmp_path / "none.txt")


def test_trajectories(recording: itm_slam.Recording, tmp_path: Path) -> None:
    truth = recording.ground_truth
    assert truth is not None and truth.poses.shape == (len(truth), 4, 4)
    assert truth.timestamps.dtype == np.int64
    again = itm_slam.Trajectory(truth.timestamps, truth.poses)
    assert np.array_equal(again.timestamps, truth.timestamps) and np.allclose(again.poses, truth.poses)
    again.save(tmp_path / "truth.txt")
    assert np.allclose(itm_slam.Trajectory.load(tmp_path / "truth.txt").poses, truth.poses, atol=1e-6)
    moved = np.array([[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]) @ truth.poses
    evaluation = itm_slam.evaluate((truth.timestamps, moved), truth)
    assert evaluation.ate.rmse < 1e-9 and evaluation.rpe_rotation.max < 1e-6
    assert evaluation.pairs == len(truth) and "ATE" in str(evaluation)
    evaluation = itm_slam.evaluate(tmp_path / "truth.txt", truth)
    assert evaluation.ate.max < 1e-5
    with pytest.raises(itm_slam.TrajectoryError, match="at least 3 pairs"):
        itm_slam.evaluate((truth.timestamps[:2], truth.poses[:2]), truth)
    with pytest.raises(ValueError, match="2 timestamps do not go with 3"):
        itm_slam.Trajectory([1, 2], truth.poses[:3])
    with pytest.raises(ValueError, match=r"poses\[1\] is no rigid motion"):
        itm_slam.Trajectory([1, 2], [np.eye(4), np.full((4, 4), np.nan)])
    with pytest.raises(ValueError, match=r"\(N, 4, 4\)"):
        itm_slam.Trajectory([1, 2], np.eye(4))
    with pytest.raises(TypeError, match="ground truth"):
        itm_slam.evaluate(truth, 3)  # type: ignore[arg-type]


def test_synthetic_recordings_without_files() -> None:
    sequence = itm_slam.synth(frames=3, size=(64, 48), noise="off")
    assert len(sequence) == 3 and len(list(sequence)) == 3
    assert sequence[-1].raw_depth is None and sequence[-1].depth.shape == (48, 64)
    assert len(sequence.ground_truth) == 3
    assert np.array_equal(sequence[1].depth, itm_slam.synth(frames=3, size=(64, 48), noise="off")[1].depth)
    wrong: list[dict[str, Any]] = [
        {"path": "nowhere"}, {"scene": "hall"}, {"noise": "some"}, {"quality": "good"}, {"size": (0, 4)}
    ]
    for arguments in wrong:
        with pytest.raises(ValueError):
            itm_slam.synth(**arguments)


def test_settings() -> None:
    def voxel(*settings: Any, **more: Any) -> Any:
        return itm_slam.resolve_settings(*settings, **more)["map"]["voxel_size_m"]

    assert voxel() == pytest.approx(0.005)
    assert voxel(map={"voxel_size_m": 0.01}) == pytest.approx(0.01)
    assert voxel(**{"map.voxel_size_m": np.float32(0.01)}) == pytest.approx(0.01)
    assert itm_slam.resolve_settings({"map": {"swap_margin_m": 1}})["map"]["swap_margin_m"] == 1
    assert voxel("[map]\nvoxel_size_m = 0.02") == pytest.approx(0.02)
    assert voxel("map.voxel_size_m = 0.02", map={"voxel_size_m": 0.015}) == pytest.approx(0.015)
    tree = itm_slam.resolve_settings(mode="surfels", tracker="type=icp,levels=rrbb", device="llvmpipe")
    assert tree["mode"] == "surfels" and tree["tracker"]["kind"] == "icp" and tree["device"]["adapter"] == "llvmpipe"
    assert itm_slam.resolve_settings({"map.dense.size": [64, 64, 64]})["map"]["dense"]["size"] == [64, 64, 64]
    with pytest.raises(itm_slam.SettingsError, match="voxel_sise_m.*voxel_size_m"):
        voxel(map={"voxel_sise_m": 0.01})
    with pytest.raises(itm_slam.SettingsError, match="map.voxel_size_m must be"):
        voxel(map={"voxel_size_m": -1})
    with pytest.raises(itm_slam.SettingsError, match="none.toml"):
        voxel("none.toml")
    with pytest.raises(TypeError, match="settings must be a dict"):
        voxel(3)
    with pytest.raises(TypeError, match="map.voxel_size_m must be a number"):
        voxel(map={"voxel_size_m": None})
    with pytest.raises(TypeError, match="keys of settings are strings"):
        voxel({3: 4})


def test_settings_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    path.write_text("[map]\nvoxel_size_m = 0.02\n")
    both: list[str | Path] = [path, str(path)]
    for given in both:
        assert itm_slam.resolve_settings(given)["map"]["voxel_size_m"] == pytest.approx(0.02)
    path.write_text("[map]\nvoxel_sise_m = 0.02\n")
    with pytest.raises(itm_slam.SettingsError, match=r"settings\.toml"):
        itm_slam.resolve_settings(path)
