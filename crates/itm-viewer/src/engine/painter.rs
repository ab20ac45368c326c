//! The pictures of the map.

use std::sync::Arc;
use std::time::{Duration, Instant};

use itm_gpu::Recorder;
use itm_gpu::mesh_view::MeshView;
use itm_slam::{Canvas, Device, Error, Intrinsics, Look, Scale, Se3, Shading, Slam};

use super::Wish;
use super::state::Shown;
use crate::camera::OrbitCamera;

/// What pictures are painted of.
pub(super) trait Subject {
    /// The camera that is followed.
    fn followed(&self) -> Intrinsics;

    /// Whether [`Subject::paint`] shows all that there is.
    fn paints_whole(&self, submap: Option<u16>) -> bool;

    /// Paints what the camera that is followed sees, at a pose.
    fn paint_followed(&mut self, pose: &Se3, shading: Shading, canvas: &Canvas) -> Result<(), Error>;

    /// Paints at once what is there.
    fn paint(&mut self, look: &Look, canvas: &Canvas) -> Result<(), Error>;

    /// Paints everything, however long that takes.
    fn paint_whole(&mut self, look: &Look, canvas: &Canvas) -> Result<(), Error>;
}

impl Subject for Slam {
    fn followed(&self) -> Intrinsics {
        self.calibration().depth
    }

    fn paints_whole(&self, submap: Option<u16>) -> bool {
        Self::paints_whole(self, submap)
    }

    fn paint_followed(&mut self, _pose: &Se3, shading: Shading, canvas: &Canvas) -> Result<(), Error> {
        self.paint_model(shading, canvas).map(|_there| ())
    }

    fn paint(&mut self, look: &Look, canvas: &Canvas) -> Result<(), Error> {
        Self::paint(self, look, canvas)
    }

    fn paint_whole(&mut self, look: &Look, canvas: &Canvas) -> Result<(), Error> {
        Self::paint_whole(self, look, canvas)
    }
}

/// A mesh that a run wrote; nothing where it wrote none.
pub(super) struct ShownMesh {
    pub(super) device: Device,
    pub(super) mesh: Option<MeshView>,
    /// Weight at the upper end of the scale of confidences.
    pub(super) full_confidence: f32,
    /// How far the run's camera saw, in metres.
    pub(super) reach_m: f32,
}

impl Subject for ShownMesh {
    fn followed(&self) -> Intrinsics {
        // What camera it was, a run's results do not say.
        OrbitCamera::intrinsics((640, 480))
    }

    fn paints_whole(&self, _submap: Option<u16>) -> bool {
        true
    }

    fn paint_followed(&mut self, pose: &Se3, shading: Shading, canvas: &Canvas) -> Result<(), Error> {
        let (camera, world_from_camera, max_depth_m) = (self.followed(), *pose, 2.0 * self.reach_m);
        self.paint(&Look { camera, world_from_camera, max_depth_m, shading, submap: None }, canvas)
    }

    fn paint(&mut self, look: &Look, canvas: &Canvas) -> Result<(), Error> {
        let Look { camera, world_from_camera, max_depth_m, shading, .. } = look;
        let scale = Scale { depth_m: [0.0, *max_depth_m], confidence: self.full_confidence };
        let mut recorder = Recorder::new(&self.device);
        canvas.clear(&mut recorder);
        if let Some(mesh) = &self.mesh {
            mesh.paint(&mut recorder, camera, world_from_camera, *max_depth_m, *shading, &scale, canvas);
        }
        canvas.show(&mut recorder);
        let _untimed = recorder.submit();
        Ok(())
    }

    fn paint_whole(&mut self, look: &Look, canvas: &Canvas) -> Result<(), Error> {
        self.paint(look, canvas)
    }
}

/// What a picture was painted of, to find out whether another is due.
#[derive(Clone, Copy, PartialEq)]
struct Painted {
    wish: Wish,
    /// Counts what changes the map or its place.
    version: u64,
    fineness: Fineness,
}

/// How much a picture shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Fineness {
    /// Fewer pixels.
    Coarse,
    /// All pixels, of what lies on the device.
    Fine,
    /// Everything that the map has.
    Whole,
}

/// Paints what the window wishes for: at once what is quick, and what is fine once nothing moves any more.
pub(super) struct Painter {
    device: Device,
    canvases: Vec<Arc<Canvas>>,
    painted: Option<Painted>,
    /// Whether the pictures are recorded, so that they are to be of one size.
    pub(super) recorded: bool,
    /// When the last picture was painted, and how long that took.
    at: Instant,
    took: Duration,
}

/// While frames are processed, a free view that nobody moves is painted again once this many times as long has passed as it took:
/// of many submaps it may take longer than a frame.
const PAINTED_PART: u32 = 4;

/// How long nothing must have moved before the fine picture is painted.
const REST_MS: u128 = 120;

impl Painter {
    pub(super) fn new(device: &Device) -> Self {
        Self {
            device: device.clone(),
            canvases: Vec::new(),
            painted: None,
            recorded: false,
            at: Instant::now(),
            took: Duration::ZERO,
        }
    }

    /// Forgets what was painted: something else is open.
    pub(super) fn forget(&mut self) {
        self.painted = None;
    }

    /// Whether what is shown is not yet all that could be.
    pub(super) fn is_unfinished(&self, wish: &Wish, version: u64, running: bool, subject: &dyn Subject) -> bool {
        self.due(wish, version, running, subject).is_some()
    }

    /// The picture that is to be painted next, if any.
    fn due(&self, wish: &Wish, version: u64, running: bool, subject: &dyn Subject) -> Option<Painted> {
        // Of the model there is one picture.
        let at_once = wish.free.is_none() || self.recorded || !self.device.capabilities().software;
        let quick = if at_once { Fineness::Fine } else { Fineness::Coarse };
        let quick = Painted { wish: *wish, version, fineness: quick };
        let same = |fineness: Fineness| {
            self.painted.is_some_and(|painted| {
                let view = Wish { moving: wish.moving, ..painted.wish };
                view == *wish && painted.version == version && painted.fineness >= fineness
            })
        };
        let looked_at = |painted: Painted| Wish { moving: wish.moving, ..painted.wish } == *wish;
        let only_grown = wish.free.is_some() && running && self.painted.is_some_and(looked_at);
        if only_grown && self.at.elapsed() < PAINTED_PART * self.took {
            return None;
        }
        if !same(quick.fineness) {
            return Some(quick);
        }
        if running || wish.moving || wish.free.is_none() || self.at.elapsed().as_millis() < REST_MS {
            return None;
        }
        let finest = if subject.paints_whole(wish.submap) { Fineness::Fine } else { Fineness::Whole };
        (!same(finest)).then_some(Painted { fineness: finest, ..quick })
    }

    /// Whether a finer picture comes once nothing has moved for a while.
    pub(super) fn rests_soon(&self, wish: &Wish, subject: &dyn Subject) -> bool {
        let finest = if subject.paints_whole(wish.submap) { Fineness::Fine } else { Fineness::Whole };
        wish.free.is_some() && !wish.moving && self.painted.is_some_and(|painted| painted.fineness < finest)
    }

    /// Paints the next picture, if one is due.
    ///
    /// # Errors
    /// Where the view is too large, or the device fails.
    pub(super) fn paint(
        &mut self,
        wish: &Wish,
        version: u64,
        running: bool,
        subject: &mut dyn Subject,
        world_from_camera: Option<Se3>,
    ) -> Result<Option<Shown>, Error> {
        let Some(due) = self.due(wish, version, running, subject) else { return Ok(None) };
        // Tried, whatever comes of it: what cannot be painted is not tried again before something changes.
        self.painted = Some(due);
        let began = Instant::now();
        let (camera, pose, canvas) = match wish.free {
            None => {
                let (camera, pose) = (subject.followed(), world_from_camera.unwrap_or_default());
                let canvas = self.canvas((camera.width, camera.height))?;
                subject.paint_followed(&pose, wish.shading, &canvas)?;
                (camera, pose, canvas)
            }
            Some((camera, pose)) => {
                let camera = if due.fineness == Fineness::Coarse { coarse(&camera) } else { camera };
                let canvas = self.canvas((camera.width, camera.height))?;
                self.paint_free(&due, &camera, &pose, subject, &canvas)?;
                (camera, pose, canvas)
            }
        };
        self.at = Instant::now();
        self.took = self.at - began;
        let follows = wish.free.is_none();
        Ok(Some(Shown { canvas, camera, world_from_camera: pose, follows }))
    }

    fn paint_free(
        &self,
        due: &Painted,
        camera: &Intrinsics,
        pose: &Se3,
        subject: &mut dyn Subject,
        canvas: &Canvas,
    ) -> Result<(), Error> {
        let Wish { shading, submap, mut max_depth_m, .. } = due.wish;
        loop {
            let look = Look { camera: *camera, world_from_camera: *pose, max_depth_m, shading, submap };
            let painted = if due.fineness == Fineness::Whole {
                subject.paint_whole(&look, canvas)
            } else {
                subject.paint(&look, canvas)
            };
            match painted {
                // What reaches too far is shown as far as it can be.
                Err(Error::Gpu(itm_slam::DeviceError::ViewTooLarge { .. })) if max_depth_m > 1.0 => max_depth_m *= 0.75,
                painted => return painted,
            }
        }
    }

    /// A canvas of a size: one of the last few, or a new one.
    fn canvas(&mut self, size: (u32, u32)) -> Result<Arc<Canvas>, Error> {
        if let Some(place) = self.canvases.iter().position(|canvas| canvas.size() == size) {
            let canvas = self.canvases.remove(place);
            self.canvases.push(Arc::clone(&canvas));
            return Ok(canvas);
        }
        if self.canvases.len() > 3 {
            self.canvases.remove(0);
        }
        let canvas = Arc::new(Canvas::new(&self.device, size)?);
        self.canvases.push(Arc::clone(&canvas));
        Ok(canvas)
    }
}

/// A camera of half as many pixels along each side.
fn coarse(camera: &Intrinsics) -> Intrinsics {
    camera.scaled_to((camera.width / 2).max(1), (camera.height / 2).max(1))
}
