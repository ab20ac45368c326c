"""Dense RGB-D SLAM: frames in as numpy arrays, poses, meshes and pictures out.

    import itm_slam

    recording = itm_slam.open("rgbd_dataset_freiburg1_desk")
    session = itm_slam.Session(recording)
    for frame in recording:
        print(session.process(frame).status)
    session.mesh().save("desk.ply")

Poses are world_from_camera, 4x4 float64; a camera looks along +z, x points right and y down. Lengths are metres, angles
radians, timestamps nanoseconds. `python -m itm_slam` is the program itm.
"""

from ._native import (
    Adapter,
    Calibration,
    CalibrationError,
    DeviceError,
    Error,
    ErrorStatistics,
    Evaluation,
    ExportError,
    Frame,
    FrameReport,
    FrameResult,
    Frames,
    Happening,
    Intrinsics,
    MapError,
    Mesh,
    PointCloud,
    Recording,
    RecordingError,
    Sequence,
    Session,
    SettingsError,
    Trajectory,
    TrajectoryError,
    __version__,
    adapters,
    evaluate,
    open,
    resolve_settings,
    synth,
)

__all__ = [
    "Adapter",
    "Calibration",
    "CalibrationError",
    "DeviceError",
    "Error",
    "ErrorStatistics",
    "Evaluation",
    "ExportError",
    "Frame",
    "FrameReport",
    "FrameResult",
    "Frames",
    "Happening",
    "Intrinsics",
    "MapError",
    "Mesh",
    "PointCloud",
    "Recording",
    "RecordingError",
    "Sequence",
    "Session",
    "SettingsError",
    "Trajectory",
    "TrajectoryError",
    "__version__",
    "adapters",
    "evaluate",
    "open",
    "resolve_settings",
    "synth",
]
