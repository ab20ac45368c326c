//! The core: frames in, poses and a map out. Synchronous, without threads.

use std::ops::Range;

use itm_core::{
    Calibration, ColourImage, Frame, Intrinsics, Mesh, ObservationWeight, OnFailure, Se3, Settings, StampedPose,
    Trajectory,
};
use itm_gpu::evaluate::Evaluator;
use itm_gpu::mesh::Extract;
use itm_gpu::photometric::PointList;
use itm_gpu::render::{Render, Scale, Shading};
use itm_gpu::view::{ViewOptions, ViewStage};
use itm_gpu::{Device, RaycastImage, Recorder, StageTimes, View};

use crate::Error;
use crate::chunked_mesh::{MeshOptions, mesh_in_chunks};
use crate::frame_result::{FrameReport, FrameResult, FrameStatus, Notice};
use crate::mapper::{Late, Mapper};
use crate::robot::Questions;
use crate::source::BlockSource as _;
use crate::tracking::{
    Against, Age, CHECK_LEVELS, ModelObjective, Moment, Motion, Tracked, Tracker, Verdict, colour_offset,
};
use crate::views::MapViews;

/// Where poses come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Poses {
    /// From tracking. The first frame's camera is the world's origin.
    Tracked,
    /// From the frames themselves.
    Given,
}

/// Reconstruction from a stream of frames.
pub struct Slam {
    pub(crate) device: Device,
    pub(crate) calibration: Calibration,
    pub(crate) settings: Settings,
    pub(crate) poses: Poses,
    view_options: ViewOptions,
    view_stage: ViewStage,
    view: View,
    pub(crate) tracker: Tracker,
    evaluator: Evaluator,
    /// Surface points with the colours of the frame before and of the map, where the tracker compares them.
    pub(crate) lists: [Option<PointList>; 2],
    pub(crate) motion: Motion,
    pub(crate) age: Age,
    pub(crate) mapper: Mapper,
    render: Render,
    pub(crate) extract: Extract,
    /// The map as seen from the last fused pose.
    pub(crate) model: RaycastImage,
    pub(crate) world_from_model: Option<Se3>,
    /// The last pose with a good verdict, to which tracking returns after a loss.
    pub(crate) last_good: Option<Se3>,
    /// Good frames still to come after a loss before frames are fused again.
    pub(crate) to_recover: u32,
    pub(crate) trajectory: Trajectory,
    /// One more than the number of the last frame.
    pub(crate) next_frame: u64,
    /// What answers questions about the map; made when first asked.
    pub(crate) questions: Option<Questions>,
}

impl std::fmt::Debug for Slam {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Slam").field("poses", &self.trajectory.len()).finish_non_exhaustive()
    }
}

impl Slam {
    /// Prepares an empty map.
    ///
    /// # Errors
    /// Where the settings or the calibration cannot be used, or the device has no room.
    pub fn new(device: &Device, calibration: &Calibration, settings: &Settings, poses: Poses) -> Result<Self, Error> {
        settings.validate()?;
        calibration.validate()?;
        let tracker = Tracker::new(settings, &calibration.depth)?;
        let needs = match poses {
            Poses::Tracked => Needs::of(&tracker),
            Poses::Given => Needs { levels: 1, lists: [None, None] },
        };
        let view_options = ViewOptions {
            depth_range_m: [settings.view.min_depth_m, settings.view.max_depth_m],
            bilateral_passes: settings.view.bilateral.passes,
            levels: needs.levels,
            vertices: false,
            observation_weights: settings.map.observation_weight == ObservationWeight::Noise || settings.map.confidence,
            colour_levels: needs.lists.iter().flatten().map(|range| range.end).max().unwrap_or(1),
        };
        let model = RaycastImage::new(device, calibration.depth)?;
        let list = |range: Option<Range<usize>>| range.map(|r| PointList::new(device, &model, r.start, r.end));
        let lists = needs.lists.map(list);
        Ok(Self {
            device: device.clone(),
            calibration: *calibration,
            settings: settings.clone(),
            poses,
            view_options,
            view_stage: ViewStage::new(device),
            view: View::new(device, calibration, &view_options),
            tracker,
            evaluator: Evaluator::new(device),
            lists,
            motion: Motion::default(),
            age: Age::default(),
            mapper: Mapper::new(device, calibration, settings)?,
            render: Render::new(device),
            extract: Extract::new(device),
            model,
            world_from_model: None,
            last_good: None,
            to_recover: 0,
            trajectory: Trajectory::default(),
            next_frame: 0,
            questions: None,
        })
    }

    /// The settings in force.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The calibration in force.
    pub fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    /// The poses so far: one for each frame that has one.
    pub fn trajectory(&self) -> &Trajectory {
        &self.trajectory
    }

    /// Blocks that the map can hold before its pools grow.
    pub fn capacity(&self) -> u32 {
        self.mapper.map.capacity()
    }

    /// Bytes of device memory that the map takes.
    pub fn map_bytes(&self) -> u64 {
        self.mapper.map.device_bytes()
    }

    /// Blocks of the map that lie in the host's store.
    pub fn stored_blocks(&self) -> usize {
        self.mapper.swapped.as_ref().map_or(0, |swapped| swapped.store.len())
    }

    /// Blocks of the map wherever they lie. Waits.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn saved_blocks(&self) -> Result<usize, Error> {
        let record = self.mapper.map.read_record()?;
        Ok((record.blocks - record.free_blocks) as usize + self.stored_blocks())
    }

    /// Takes in a frame: view, track, allocate, integrate, raycast.
    ///
    /// # Errors
    /// Where an image has another size than the calibration says, a file with poses cannot be read, or the device fails.
    /// That a frame could not be tracked is no error but a status.
    pub fn process(&mut self, frame: &Frame) -> Result<FrameResult, Error> {
        let _span = tracing::info_span!("frame", index = frame.index).entered();
        let view_times = self.look(frame)?;
        let report = self.mapper.consume()?.map(|late| self.report(late));
        self.motion.sense(frame);
        let started = std::time::Instant::now();
        let located = self.locate(frame)?;
        let track_ms = started.elapsed().as_secs_f64() * 1e3;
        self.conclude(frame, located, view_times, track_ms, report)
    }

    /// Takes in a frame whose pose is known from elsewhere, and fuses it there. Tracking goes on from it.
    ///
    /// # Errors
    /// As [`Slam::process`].
    pub fn place(&mut self, frame: &Frame, world_from_camera: &Se3) -> Result<FrameResult, Error> {
        let _span = tracing::info_span!("frame", index = frame.index).entered();
        let view_times = self.look(frame)?;
        let report = self.mapper.consume()?.map(|late| self.report(late));
        self.motion.sense(frame);
        let located = if world_from_camera.is_finite() {
            Located { status: FrameStatus::Placed, tracked: None, pose: Some(*world_from_camera), fuse: true }
        } else {
            Located::without(FrameStatus::NoPose)
        };
        self.conclude(frame, located, view_times, 0.0, report)
    }

    /// Finds a frame's pose in the map from certain poses, and leaves everything as it is; `None` without a map.
    ///
    /// # Errors
    /// As [`Slam::process`].
    pub fn probe(&mut self, frame: &Frame, starts: &[Se3]) -> Result<Option<Tracked>, Error> {
        let _untimed = self.look(frame)?;
        let Some(world_from_model) = self.world_from_model else { return Ok(None) };
        let mut tracker = self.tracker.clone();
        let (motion, age) = (self.motion.clone(), self.age);
        let mut objective = self.objective(frame, world_from_model);
        tracker.track_from(&mut objective, &Moment { frame, motion: &motion, age }, starts).map(Some)
    }

    /// Uploads a frame, and makes what tracking and fusion use of it.
    fn look(&mut self, frame: &Frame) -> Result<StageTimes, Error> {
        let mut recorder = Recorder::timed(&self.device);
        let colourless;
        let frame_used = if self.settings.view.colour || frame.colour.is_none() {
            frame
        } else {
            colourless = Frame { colour: None, ..frame.clone() };
            &colourless
        };
        self.view_stage.record(&mut recorder, &mut self.view, frame_used, &self.view_options)?;
        Ok(recorder.submit())
    }

    /// Where the frame's camera is, and what is to become of the frame.
    fn locate(&mut self, frame: &Frame) -> Result<Located, Error> {
        if self.poses == Poses::Given {
            let pose = frame.world_from_camera.filter(Se3::is_finite);
            let status = if pose.is_some() { FrameStatus::Placed } else { FrameStatus::NoPose };
            return Ok(Located { status, tracked: None, pose, fuse: true });
        }
        let Some(world_from_model) = self.world_from_model else {
            let pose = self.first_pose(frame)?;
            let status = if pose.is_some() { FrameStatus::Placed } else { FrameStatus::NoPose };
            return Ok(Located { status, tracked: None, pose, fuse: true });
        };
        let settings = &self.settings.tracker;
        let on_failure = settings.on_failure;
        let after_loss = settings.verdict.frames_to_recover + 1;
        // What was found after a loss may be wrong, so the search goes on until frames are good again.
        let searching = on_failure == OnFailure::Relocalise && self.to_recover > 0;
        let mut further = if searching { around(&world_from_model) } else { Vec::new() };
        if self.motion.last().is_none() {
            // In a saved map no frame has come before.
            further.insert(0, world_from_model);
        }
        let mut tracker = self.tracker.clone();
        let (motion, age) = (self.motion.clone(), self.age);
        let mut objective = self.objective(frame, world_from_model);
        let tracked = tracker.track(&mut objective, &Moment { frame, motion: &motion, age }, &further)?;
        self.tracker = tracker;
        let pose = Some(tracked.world_from_camera);
        let reason = tracked.reasons.join("; ");
        let settings = &self.settings.tracker;
        let located = match tracked.verdict {
            Verdict::Good if self.to_recover > 1 => {
                self.to_recover -= 1;
                let left = self.to_recover;
                let reason = format!("tracked again after a loss; fused after {left} more good frames");
                Located { status: FrameStatus::Poor { reason }, tracked: Some(tracked), pose, fuse: false }
            }
            Verdict::Good => {
                self.to_recover = 0;
                self.last_good = pose;
                Located { status: FrameStatus::Tracked, tracked: Some(tracked), pose, fuse: true }
            }
            Verdict::Poor => {
                let fuse = settings.verdict.fuse_poor && self.to_recover == 0;
                if self.to_recover > 0 {
                    // Good ones must come in a row; but it is no longer lost.
                    self.to_recover = after_loss - 1;
                }
                Located { status: FrameStatus::Poor { reason }, tracked: Some(tracked), pose, fuse }
            }
            Verdict::Lost if on_failure == OnFailure::Ignore => {
                let status = FrameStatus::Lost { reason };
                Located { status, tracked: Some(tracked), pose: Some(world_from_model), fuse: true }
            }
            Verdict::Lost => {
                self.to_recover = match on_failure {
                    OnFailure::Relocalise => after_loss,
                    _ => 0,
                };
                self.return_to_last_good()?;
                Located { tracked: Some(tracked), ..Located::without(FrameStatus::Lost { reason }) }
            }
        };
        Ok(located)
    }

    /// Tracking begins at a pose in the map.
    pub(crate) fn start_at(&mut self, world_from_camera: &Se3) -> Result<(), Error> {
        let far = self.settings.view.max_depth_m + self.settings.map.truncation_m;
        self.mapper.cast_for_tracking(&self.model, world_from_camera, far)?;
        self.world_from_model = Some(*world_from_camera);
        self.last_good = self.world_from_model;
        let mut recorder = Recorder::new(&self.device);
        self.record_map_list(&mut recorder, world_from_camera);
        let _untimed = recorder.submit();
        Ok(())
    }

    /// Where the world begins: at the first camera, unless poses come from files.
    fn first_pose(&self, frame: &Frame) -> Result<Option<Se3>, Error> {
        self.tracker.pose_from_file(frame).unwrap_or(Ok(Some(Se3::IDENTITY)))
    }

    /// Tracking goes on from the last pose that could be relied on.
    fn return_to_last_good(&mut self) -> Result<(), Error> {
        let Some(last_good) = self.last_good else { return Ok(()) };
        self.motion.return_to(last_good);
        if self.world_from_model != Some(last_good) {
            let far = self.settings.view.max_depth_m + self.settings.map.truncation_m;
            self.mapper.cast_for_tracking(&self.model, &last_good, far)?;
            self.world_from_model = Some(last_good);
            // The frame before was taken elsewhere.
            let mut recorder = Recorder::new(&self.device);
            if let Some(list) = &self.lists[Against::Previous as usize] {
                list.clear(&mut recorder);
            }
            self.record_map_list(&mut recorder, &last_good);
            let _untimed = recorder.submit();
        }
        Ok(())
    }

    /// Fuses a frame, or does not, and prepares the next one's tracking.
    fn conclude(
        &mut self,
        frame: &Frame,
        located: Located,
        view_times: StageTimes,
        track_ms: f64,
        report: Option<FrameReport>,
    ) -> Result<FrameResult, Error> {
        let Located { mut status, tracked, mut pose, mut fuse } = located;
        // Where the map is only looked at.
        fuse &= self.settings.map.fuse;
        self.next_frame = frame.index + 1;
        let mut fused = false;
        if let Some(world_from_camera) = pose {
            let lead = self.motion.colour_lead(frame, &self.settings.view);
            let offset = colour_offset(&self.motion.last(), &world_from_camera, lead);
            let colour_from_depth = self.calibration.colour_from_depth * offset.inverse();
            if fuse {
                let times = vec![view_times];
                let (view, model) = (&self.view, &self.model);
                fused = self.mapper.fuse(frame.index, view, &world_from_camera, &colour_from_depth, model, times)?;
                if !fused {
                    (status, pose) = (FrameStatus::NoDepth, None);
                }
            } else {
                let far = self.settings.view.max_depth_m + self.settings.map.truncation_m;
                self.mapper.follow(&self.model, &world_from_camera, far)?;
            }
            if let Some(world_from_camera) = pose {
                self.age.frames += u64::from(fused);
                self.world_from_model = Some(world_from_camera);
                if matches!(status, FrameStatus::Placed) {
                    self.last_good = pose;
                }
                self.motion.moved_to(frame, world_from_camera);
                self.list_colours(&(world_from_camera * colour_from_depth.inverse()), &world_from_camera);
                self.trajectory.push(StampedPose { timestamp: frame.timestamp, world_from_camera });
            }
        }
        Ok(FrameResult {
            index: frame.index,
            timestamp: frame.timestamp,
            world_from_camera: pose,
            status,
            tracked,
            fused,
            track_ms,
            report,
        })
    }

    fn objective(&mut self, frame: &Frame, world_from_model: Se3) -> ModelObjective<'_> {
        ModelObjective {
            evaluator: &mut self.evaluator,
            view: &self.view,
            model: &self.model,
            lists: self.lists.each_ref().map(Option::as_ref),
            world_from_model,
            before: self.motion.last(),
            colour_lead: self.motion.colour_lead(frame, &self.settings.view),
            depth_from_colour: self.calibration.colour_from_depth.inverse(),
        }
    }

    /// Lists the model's points with their colours for the next frame's tracking.
    fn list_colours(&self, world_from_colour: &Se3, world_from_camera: &Se3) {
        if self.lists.iter().all(Option::is_none) {
            return;
        }
        let mut recorder = Recorder::new(&self.device);
        if let Some(list) = &self.lists[Against::Previous as usize] {
            let stage = &self.evaluator.photometric;
            stage.list_previous(&mut recorder, list, &self.model, &self.view, world_from_colour, 0.0);
        }
        self.record_map_list(&mut recorder, world_from_camera);
        let _untimed = recorder.submit();
    }

    fn record_map_list(&self, recorder: &mut Recorder, world_from_camera: &Se3) {
        if let Some(list) = &self.lists[Against::Map as usize] {
            let stage = &self.evaluator.photometric;
            stage.list_map(recorder, list, &self.model, &self.mapper.map, world_from_camera, 0.0);
        }
    }

    fn report(&self, late: Late) -> FrameReport {
        let Late { frame, record, stage_ms } = late;
        let mut notices = Vec::new();
        // What waits although there is room gets it as soon as it is seen again.
        if record.pending > 0 && self.mapper.is_full(&record) {
            let capacity = self.mapper.map.capacity();
            let needed = u64::from(capacity) + u64::from(record.pending);
            let needed_mib = (needed * self.mapper.map.layout().kind.block_bytes()).div_ceil(1 << 20);
            notices.push(Notice::Waiting { blocks: record.pending, capacity, needed_mib });
        }
        if let Some(reason) = self.mapper.store_trouble() {
            notices.push(Notice::HostStore { reason });
        }
        if record.dropped > 0 {
            notices.push(Notice::Dropped { blocks: record.dropped });
        }
        FrameReport { index: frame, record, stage_ms, notices }
    }

    /// The reports that are still due, when no more frames come.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn finish(&mut self) -> Result<Vec<FrameReport>, Error> {
        let late = self.mapper.report_early()?;
        Ok(late.into_iter().map(|l| self.report(l)).collect())
    }

    /// The surface of the whole map, wherever its blocks lie, as a mesh (world frame, metres). `progress` is called with blocks done and blocks in
    /// all.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn mesh(&mut self, progress: &mut dyn FnMut(u32, u32)) -> Result<Mesh, Error> {
        let device = self.device.clone();
        if let Some(mut live) = self.mapper.live()? {
            let count = |n: u64| u32::try_from(n).unwrap_or(u32::MAX);
            let mut told = |done, of| progress(count(done), count(of));
            return mesh_in_chunks(&device, &mut live, &MeshOptions::default(), &mut told);
        }
        Ok(self.extract.run(&self.mapper.map, &itm_gpu::mesh::Options::default(), progress)?)
    }

    /// A picture of the map as a camera sees it from a pose, up to `max_depth_m`. Pixels that show nothing have alpha 0.
    ///
    /// # Errors
    /// Where the view reaches over more blocks than the device can index, or the device fails.
    pub fn render(
        &mut self,
        camera: &Intrinsics,
        world_from_camera: &Se3,
        max_depth_m: f32,
        shading: Shading,
    ) -> Result<ColourImage, Error> {
        let scale = Scale { depth_m: [0.0, max_depth_m], confidence: crate::views::full_confidence(&self.settings) };
        let device = self.device.clone();
        if let Some(mut live) = self.mapper.live()? {
            let mut views = MapViews::new(&device, live.layout(), 0, 1)?;
            views.look(&mut live, camera, world_from_camera, max_depth_m)?;
            return views.picture(shading, &scale);
        }
        let image = self.mapper.cast(camera, world_from_camera, max_depth_m)?;
        Ok(self.render.run(&self.mapper.map, &image, world_from_camera, shading, &scale)?)
    }
}

/// Where a frame's camera is, and what is to become of the frame.
struct Located {
    status: FrameStatus,
    tracked: Option<Tracked>,
    pose: Option<Se3>,
    /// Whether the frame is fused at its pose.
    fuse: bool,
}

impl Located {
    fn without(status: FrameStatus) -> Self {
        Self { status, tracked: None, pose: None, fuse: false }
    }
}

/// Poses around one, to start from after a loss: turned as far as an image still overlaps, or moved aside while turning.
fn around(pose: &Se3) -> Vec<Se3> {
    let mut poses = Vec::new();
    for degrees in [8.0_f64, -8.0, 16.0, -16.0] {
        let angle = degrees.to_radians();
        poses.push(*pose * Se3::exp([0.0, 0.0, 0.0, angle, 0.0, 0.0]));
        for aside_m in [-0.15, 0.0, 0.15] {
            poses.push(*pose * Se3::exp([aside_m, 0.0, 0.0, 0.0, angle, 0.0]));
        }
    }
    poses
}

/// What a tracker's plans need of a view and of the model.
struct Needs {
    /// Levels of the depth pyramid.
    levels: usize,
    /// Levels of the point lists, by [`Against`].
    lists: [Option<Range<usize>>; 2],
}

impl Needs {
    fn of(tracker: &Tracker) -> Self {
        let mut needs = Self { levels: CHECK_LEVELS, lists: [None, None] };
        for level in tracker.plans(Age::default()).iter().flat_map(|plan| &plan.levels) {
            needs.levels = needs.levels.max(level.request.level + 1);
            for (range, term) in needs.lists.iter_mut().zip(&level.request.colour) {
                let Some(term) = term else { continue };
                let known = range.get_or_insert(term.level..term.level + 1);
                *known = known.start.min(term.level)..known.end.max(term.level + 1);
            }
        }
        needs
    }
}
