"""Tracks the camera of a recording, and compares its way with the true one where that is known.

python track_recording.py path/to/recording trajectory.txt
"""

import sys

import itm_slam


def main(path: str, trajectory: str) -> None:
    recording = itm_slam.open(path)
    session = itm_slam.Session(recording, mode="loop-closure")
    for frame in recording:
        result = session.process(frame)
        if not result.good:
            print(f"frame {frame.index} is {result.status}: {'; '.join(result.reasons)}")
        for happening in result.happenings:
            if happening.kind != "keyframe":
                print(f"frame {frame.index}: {happening}")
    session.settle()
    found = session.trajectory()
    found.save(trajectory)
    print(f"{len(found)} of {len(recording)} frames have a pose")
    if recording.ground_truth is not None:
        print(itm_slam.evaluate(found, recording.ground_truth))


if __name__ == "__main__":
    main(*sys.argv[1:])
