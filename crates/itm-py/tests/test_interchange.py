"""What `itm convert` writes is read by the libraries of PyPI."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "itm-io" / "tests" / "mcap" / "interchange.py"


@pytest.mark.skipif(sys.version_info < (3, 11), reason="the libraries' versions need Python 3.11")
@pytest.mark.skipif(not SCRIPT.exists(), reason="the workspace is not there")
def test_others_read_our_mcap(room: Path, tmp_path: Path) -> None:
    ours = tmp_path / "room.mcap"
    convert = [sys.executable, "-m", "itm_slam", "convert", str(room), str(ours)]
    converted = subprocess.run(convert, capture_output=True, text=True)
    assert converted.returncode == 0, converted.stderr
    # It checks schemas, sizes, encodings, checksums and poses.
    read = subprocess.run([sys.executable, str(SCRIPT), "read", str(ours)], capture_output=True, text=True)
    assert read.returncode == 0, read.stderr
    found = [line.split() for line in read.stdout.splitlines()]
    # A topic, its schema, how many messages, and of images their size and encoding; the recording's depth is in fifths of millimetres.
    images = {line[1]: line[2:] for line in found if len(line) > 3}
    assert images["foxglove.RawImage"] == ["10", "160", "120", "32FC1"], read.stdout
    assert images["foxglove.CompressedImage"] == ["10", "160", "120", "png"], read.stdout
    counts = {line[1]: int(line[2]) for line in found}
    assert counts["foxglove.PoseInFrame"] == 10 and counts["foxglove.CameraCalibration"] >= 1, read.stdout
    assert counts["sensor_msgs/msg/Imu"] > 10, read.stdout
