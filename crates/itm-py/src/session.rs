//! Reconstruction from a stream of frames.

use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread::{self, ThreadId};
use std::time::Instant;

use itm_core::surfel::cloud_of_surfels;
use itm_core::{Se3, Settings};
use itm_io::map_file::MapReader;
use itm_io::recording::nominal_timestamp;
use itm_slam::{Device, Poses, SavedSession, SessionOptions, Shading, Slam, Start};
use numpy::{PyArray1, PyArray2, PyArray3};
use pyo3::exceptions::{PyRuntimeError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::calibration::{self, Calibration, Intrinsics};
use crate::frame::Frame;
use crate::interrupt::with_progress;
use crate::recording::Recording;
use crate::result::{FrameReport, FrameResult, Happening};
use crate::settings::{Given, as_dict};
use crate::surface::{Mesh, PointCloud};
use crate::synth::Sequence;
use crate::trajectory::Trajectory;
use crate::{arrays, errors};

/// Reconstruction from a stream of frames: poses, a map, meshes and pictures of it.
///
/// Its calibration is a Calibration, the Intrinsics of one camera for both images (depth in millimetres), or a Recording or
/// Sequence, whose own is taken. Settings are a dict, TOML text or a TOML file's path; keyword arguments win over them:
/// mode="surfels", map={"voxel_size_m": 0.01}, **{"map.voxel_size_m": 0.01}. poses is 'tracked', or 'given' to fuse frames at
/// poses of their own.
#[pyclass(module = "itm_slam", frozen)]
pub(crate) struct Session {
    slam: Mutex<Slam>,
    /// The thread that is meshing, which calls Python back.
    meshing: Mutex<Option<ThreadId>>,
    calibration: itm_core::Calibration,
    settings: Settings,
    device: String,
}

/// What a session is made for.
enum Source<'a, 'py> {
    Calibration(Box<itm_core::Calibration>),
    Recording(&'a Bound<'py, Recording>),
}

impl<'a, 'py> Source<'a, 'py> {
    fn of(value: &'a Bound<'py, PyAny>) -> PyResult<Self> {
        if let Ok(recording) = value.cast::<Recording>() {
            return Ok(Self::Recording(recording));
        }
        if let Ok(sequence) = value.cast::<Sequence>() {
            return Ok(Self::Calibration(Box::new(sequence.get().0.calibration())));
        }
        calibration::of(value).map(Box::new).map(Self::Calibration)
    }

    fn calibration(&self) -> itm_core::Calibration {
        match self {
            Self::Calibration(calibration) => **calibration,
            Self::Recording(recording) => recording.get().info.calibration,
        }
    }

    /// Settings as they come to be in force, once it is clear that the source has what they need.
    fn fit(&self, settings: Settings, poses: Poses, start: Start) -> PyResult<Settings> {
        let Self::Recording(recording) = self else { return Ok(settings) };
        let options = SessionOptions { settings, poses, frames: None, start };
        let recording = recording.get();
        recording
            .with(|recording| itm_slam::Session::check(recording, &options))
            .map_err(|error| errors::of_slam(error, errors::recording))?;
        Ok(itm_slam::Session::fit(&options.settings, &recording.info, poses))
    }
}

fn poses_from(name: &str) -> PyResult<Poses> {
    match name {
        "tracked" => Ok(Poses::Tracked),
        "given" => Ok(Poses::Given),
        other => Err(PyValueError::new_err(format!("poses must be 'tracked' or 'given', not '{other}'"))),
    }
}

fn open_device(adapter: &str) -> Result<Device, PyErr> {
    Device::open(adapter).map_err(|error| errors::of_gpu(&error))
}

impl Session {
    fn of(slam: Slam, device: &Device) -> Self {
        let (calibration, settings) = (*slam.calibration(), slam.settings().clone());
        Self {
            slam: Mutex::new(slam),
            meshing: Mutex::default(),
            calibration,
            settings,
            device: device.name().to_owned(),
        }
    }

    /// Does something with the session while other threads of Python go on; one thread has access at a time.
    fn with<T: Send>(&self, py: Python<'_>, what: impl FnOnce(&mut Slam) -> T + Send) -> PyResult<T> {
        self.check_not_within()?;
        Ok(py.detach(|| what(&mut self.lock())))
    }

    fn lock(&self) -> MutexGuard<'_, Slam> {
        self.slam.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn meshing(&self) -> MutexGuard<'_, Option<ThreadId>> {
        self.meshing.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Refuses what would wait for itself: a call from within a progress callback, or a signal's handler, of this session.
    fn check_not_within(&self) -> PyResult<()> {
        if *self.meshing() == Some(thread::current().id()) {
            return Err(PyRuntimeError::new_err("a session cannot be used within its own progress callback"));
        }
        Ok(())
    }

    /// The surface of the whole map.
    fn extract(&self, py: Python<'_>, progress: Option<&Bound<'_, PyAny>>) -> PyResult<itm_core::Mesh> {
        self.check_not_within()?;
        let own = Some(thread::current().id());
        let mesh = with_progress(py, progress, |told| {
            let mut slam = self.lock();
            *self.meshing() = own;
            slam.mesh(told)
        });
        // Another thread may have begun already.
        self.meshing().take_if(|thread| Some(*thread) == own);
        mesh?.map_err(|error| errors::of_slam(error, errors::map))
    }

    /// A frame from what `process` was given; the index, and where none was given the time, are still to be the session's.
    fn frame(
        &self,
        depth: &Bound<'_, PyAny>,
        colour: Option<&Bound<'_, PyAny>>,
        timestamp: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Pushed> {
        if let Ok(frame) = depth.cast::<Frame>() {
            if colour.is_some() || timestamp.is_some() {
                return Err(PyTypeError::new_err(
                    "a Frame has its own colour and timestamp: give none beside it, or give its arrays",
                ));
            }
            let frame = frame.get();
            let fits = frame.calibration.depth_conversion == self.calibration.depth_conversion;
            if !fits && matches!(frame.frame.depth, itm_core::DepthImage::Raw(_)) {
                return Err(PyValueError::new_err(
                    "the frame's depth has another unit than the session's calibration says: make the session of the recording's \
                     calibration, or give the frame's arrays (depth is in metres)",
                ));
            }
            return Ok(Pushed::Frame(frame.frame.clone()));
        }
        let depth_image = arrays::depth(depth, &self.calibration)?;
        let colour = colour.map(|colour| arrays::colour(colour, &self.calibration)).transpose()?;
        let timestamp = timestamp.map(arrays::timestamp).transpose()?;
        Ok(Pushed::Arrays { depth: depth_image, colour, timestamp })
    }
}

/// A frame as it was given.
enum Pushed {
    Frame(itm_core::Frame),
    Arrays {
        depth: itm_core::DepthImage,
        colour: Option<itm_core::ColourImage>,
        timestamp: Option<itm_core::Timestamp>,
    },
}

impl Pushed {
    /// With what the session says where nothing was: the number of frames so far.
    fn into_frame(self, index: u64) -> itm_core::Frame {
        match self {
            Self::Frame(frame) => frame,
            Self::Arrays { depth, colour, timestamp } => {
                let nominal = || nominal_timestamp(u32::try_from(index).unwrap_or(u32::MAX));
                itm_core::Frame::new(index, timestamp.unwrap_or_else(nominal), depth, colour)
            }
        }
    }
}

#[pymethods]
impl Session {
    #[new]
    #[pyo3(signature = (calibration, settings=None, *, poses="tracked", **more))]
    fn new(
        py: Python<'_>,
        calibration: &Bound<'_, PyAny>,
        settings: Option<&Bound<'_, PyAny>>,
        poses: &str,
        more: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let (source, poses) = (Source::of(calibration)?, poses_from(poses)?);
        let settings = source.fit(Given::new(settings, more)?.resolve(None)?, poses, Start::Afresh)?;
        let calibration = source.calibration();
        py.detach(|| {
            let device = open_device(&settings.device.adapter)?;
            let slam = Slam::new(&device, &calibration, &settings, poses);
            Ok(Self::of(slam.map_err(|error| errors::of_slam(error, errors::map))?, &device))
        })
    }

    /// Goes on from a session that was saved, with its settings and its calibration; device is another adapter.
    #[staticmethod]
    #[pyo3(signature = (path, *, device=None))]
    fn resume(py: Python<'_>, path: PathBuf, device: Option<&str>) -> PyResult<Self> {
        py.detach(|| {
            let failed = |error| errors::of_slam(error, errors::map);
            let saved = SavedSession::open(&path).map_err(failed)?;
            let device = open_device(device.unwrap_or(&saved.settings.device.adapter))?;
            Ok(Self::of(Slam::resume(&device, &path).map_err(failed)?, &device))
        })
    }

    /// Starts a new session in a saved map. Its own settings hold where a dict or keywords do not say otherwise; a TOML file, or
    /// its text, stands for all of them.
    /// pose is where the first frame's camera is, or nearly; without one it is found by the map's keyframes.
    #[staticmethod]
    #[pyo3(signature = (path, calibration, settings=None, *, pose=None, **more))]
    fn in_map(
        py: Python<'_>,
        path: PathBuf,
        calibration: &Bound<'_, PyAny>,
        settings: Option<&Bound<'_, PyAny>>,
        pose: Option<&Bound<'_, PyAny>>,
        more: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let source = Source::of(calibration)?;
        let pose = pose.map(|pose| arrays::pose(pose, "pose")).transpose()?;
        let given = Given::new(settings, more)?;
        let reader = py.detach(|| MapReader::open(&path)).map_err(|error| errors::of_io(&error, errors::map))?;
        let of_map = (format!("the settings in '{}'", path.display()), reader.header().settings.clone());
        let start = Start::InMap { path: path.clone(), world_from_camera: pose };
        let settings = given.resolve(Some((&of_map.0, &of_map.1)))?;
        let settings = source.fit(settings, Poses::Tracked, start)?;
        let calibration = source.calibration();
        py.detach(|| {
            let device = open_device(&settings.device.adapter)?;
            let slam = Slam::in_map(&device, &calibration, &settings, &path, pose.as_ref());
            Ok(Self::of(slam.map_err(|error| errors::of_slam(error, errors::map))?, &device))
        })
    }

    /// Takes in a frame: finds its pose, fuses it into the map.
    ///
    /// depth is HxW, uint16 as the sensor gives it (by default millimetres; the calibration says) or float32 metres along the
    /// optical axis, 0 or nan where nothing was measured; or a Frame, which has all else too. colour is uint8, HxWx3 (red,
    /// green, blue), HxWx4 (the fourth 0 where a pixel has none) or HxW (grey). timestamp is nanoseconds (int) or seconds
    /// (float); without one, frames count as taken 30 times a second. pose, world_from_camera as 4x4, is where the frame is
    /// fused in place of tracking. That a frame cannot be tracked is no error: the result's status says so.
    #[pyo3(signature = (depth, colour=None, timestamp=None, pose=None))]
    fn process(
        &self,
        py: Python<'_>,
        depth: &Bound<'_, PyAny>,
        colour: Option<&Bound<'_, PyAny>>,
        timestamp: Option<&Bound<'_, PyAny>>,
        pose: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<FrameResult> {
        let pose = pose.map(|pose| arrays::pose(pose, "pose")).transpose()?;
        let frame = self.frame(depth, colour, timestamp)?;
        let (result, total_ms) = self.with(py, |slam| {
            let started = Instant::now();
            let frame = frame.into_frame(slam.frames());
            let result = match pose {
                Some(pose) => slam.place(&frame, &pose),
                None => slam.process(&frame),
            };
            (result, started.elapsed().as_secs_f64() * 1e3)
        })?;
        let result = result.map_err(|error| errors::of_slam(error, errors::recording))?;
        Ok(FrameResult::new(result, total_ms))
    }

    /// A picture of the map, HxWx4 uint8; the fourth is 0 where nothing is seen. kind is 'colour', 'phong', 'grey', 'normals', 'depth' or
    /// 'confidence'; pose is world_from_camera (by default the last one), camera the Intrinsics (by default the depth camera).
    #[pyo3(signature = (pose=None, kind="colour", *, camera=None, max_depth_m=None))]
    fn render<'py>(
        &self,
        py: Python<'py>,
        pose: Option<&Bound<'py, PyAny>>,
        kind: &str,
        camera: Option<&Intrinsics>,
        max_depth_m: Option<f32>,
    ) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let shading = match kind {
            "colour" => Shading::Colour,
            "grey" => Shading::Grey,
            "phong" => Shading::Phong,
            "normals" => Shading::Normals,
            "depth" => Shading::Depth,
            "confidence" => Shading::Confidence,
            other => {
                return Err(PyValueError::new_err(format!(
                    "kind must be 'colour', 'phong', 'grey', 'normals', 'depth' or 'confidence', not '{other}'"
                )));
            }
        };
        let max_depth_m = max_depth_m.unwrap_or(self.settings.view.max_depth_m);
        if !(max_depth_m > 0.0 && max_depth_m <= 1000.0) {
            return Err(PyValueError::new_err(format!(
                "max_depth_m must be above 0 and at most 1000, not {max_depth_m}"
            )));
        }
        let camera = camera.map_or(self.calibration.depth, |camera| camera.0);
        camera.validate("picture").map_err(|error| errors::calibration(error.to_string()))?;
        let pose = pose.map(|pose| arrays::pose(pose, "pose")).transpose()?;
        let picture = self.with(py, |slam| {
            let last = || slam.corrected_trajectory().poses().last().map(|pose| pose.world_from_camera);
            let pose = pose.or_else(last)?;
            Some(slam.render(&camera, &pose, max_depth_m, shading))
        })?;
        let picture =
            picture.ok_or_else(|| PyValueError::new_err("no frame has a pose yet: say from which one to render"))?;
        let picture = picture.map_err(|error| errors::of_slam(error, errors::map))?;
        arrays::channels(py, picture.size(), picture.into_data())
    }

    /// The surface of the whole map. progress is called with what is done and what there is in all; Ctrl-C, or an exception of
    /// it, ends the call, and the session can go on.
    #[pyo3(signature = (progress=None))]
    fn mesh(&self, py: Python<'_>, progress: Option<&Bound<'_, PyAny>>) -> PyResult<Mesh> {
        self.extract(py, progress).map(Mesh)
    }

    /// The map as points: the surfels of a map of surfels, the mesh's vertices of one of voxels.
    #[pyo3(signature = (progress=None))]
    fn point_cloud(&self, py: Python<'_>, progress: Option<&Bound<'_, PyAny>>) -> PyResult<PointCloud> {
        if self.settings.mode.has_surfels() {
            let surfels = self.with(py, |slam| slam.surfels())?;
            let surfels = surfels.map_err(|error| errors::of_slam(error, errors::map))?;
            return Ok(PointCloud(cloud_of_surfels(&surfels)));
        }
        Ok(PointCloud(self.extract(py, progress)?.into()))
    }

    /// Distances in metres from points (Nx3, world) to the nearest surface, as the map has them: N float32, positive in free
    /// space, at most the truncation band, nan where nothing was observed.
    fn distances<'py>(&self, py: Python<'py>, points: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyArray1<f32>>> {
        let points = arrays::points(points, "points")?;
        let distances = self.with(py, |slam| slam.distances(&points))?;
        let distances = distances.map_err(|error| errors::of_slam(error, errors::map))?;
        Ok(arrays::row(py, distances.into_iter().map(|distance| distance.unwrap_or(f32::NAN)).collect()))
    }

    /// Saves the map, and all that is needed to go on as if nothing had been saved. The file takes its name only once it is
    /// whole.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        self.with(py, |slam| slam.save(&path))?.map_err(|error| errors::of_slam(error, errors::map))
    }

    /// The poses so far, of the frames that have one. With submaps as these lie now; as they were found, if not corrected.
    #[pyo3(signature = (*, corrected=true))]
    fn trajectory(&self, py: Python<'_>, corrected: bool) -> PyResult<Trajectory> {
        let of = |slam: &mut Slam| {
            if corrected { slam.corrected_trajectory() } else { slam.trajectory().clone() }
        };
        self.with(py, of).map(Trajectory)
    }

    /// The reports that are still due, when no more frames come.
    fn finish(&self, py: Python<'_>) -> PyResult<Vec<FrameReport>> {
        let reports = self.with(py, Slam::finish)?.map_err(|error| errors::of_slam(error, errors::map))?;
        Ok(reports.into_iter().map(FrameReport).collect())
    }

    /// Optimises the submaps' poses with all that is known, at the end of a run; None where there is one submap.
    fn settle(&self, py: Python<'_>) -> PyResult<Option<Happening>> {
        Ok(self.with(py, Slam::settle)?.map(Happening))
    }

    /// What was no use and was left out, since this was last asked for.
    fn warnings(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        self.with(py, |slam| std::iter::from_fn(|| slam.next_warning()).map(|warning| warning.to_string()).collect())
    }

    /// Every setting in force, as nested dictionaries.
    #[getter]
    fn settings<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        as_dict(py, &self.settings)
    }

    /// The same as TOML.
    #[getter]
    fn settings_toml(&self) -> String {
        self.settings.to_toml()
    }

    /// The cameras.
    #[getter]
    fn calibration(&self) -> Calibration {
        Calibration(self.calibration)
    }

    /// The adapter's name.
    #[getter]
    fn device(&self) -> &str {
        &self.device
    }

    /// Frames taken in so far, those before the session was saved included.
    #[getter]
    fn frames(&self, py: Python<'_>) -> PyResult<u64> {
        self.with(py, |slam| slam.frames())
    }

    /// Bytes of device memory that the map takes.
    #[getter]
    fn map_bytes(&self, py: Python<'_>) -> PyResult<u64> {
        self.with(py, |slam| slam.map_bytes())
    }

    /// Poses of the keyframes by which a place is found again, world_from_camera, Nx4x4 float64.
    #[getter]
    fn keyframes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let poses: Vec<Se3> = self.with(py, |slam| {
            let submaps = slam.submaps();
            let world_from = |submap: u16| submaps.get(usize::from(submap)).map(|s| s.world_from_submap);
            let pose = |k: &itm_slam::Keyframe| world_from(k.submap).unwrap_or_default() * k.submap_from_camera;
            slam.keyframes().iter().map(pose).collect()
        })?;
        arrays::matrices(py, poses.into_iter())
    }

    /// Where the submaps lie in the world, Nx4x4 float64; empty where the map is one.
    #[getter]
    fn submaps<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let poses: Vec<Se3> = self.with(py, |slam| slam.submaps().iter().map(|s| s.world_from_submap).collect())?;
        arrays::matrices(py, poses.into_iter())
    }

    /// Links between submaps, each as (from, to, whether it closes a loop).
    #[getter]
    fn submap_links(&self, py: Python<'_>) -> PyResult<Vec<(u16, u16, bool)>> {
        self.with(py, |slam| slam.submap_links().iter().map(|link| (link.from, link.to, link.closure)).collect())
    }

    /// The last pose, world_from_camera, 4x4 float64; None before the first.
    #[getter]
    fn pose<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        let last = self.with(py, |slam| slam.corrected_trajectory().poses().last().map(|p| p.world_from_camera))?;
        last.map(|pose| arrays::matrix(py, &pose)).transpose()
    }

    fn __repr__(&self) -> String {
        format!("<Session '{}' on {}>", self.settings.mode.name(), self.device)
    }
}
