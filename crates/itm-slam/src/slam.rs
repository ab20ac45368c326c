//! The core: frames in, poses and a map out. Synchronous, without threads.

use std::collections::VecDeque;

use itm_core::{Calibration, Frame, Mesh, ObservationWeight, OnFailure, Se3, Settings, StampedPose, Trajectory};
use itm_gpu::evaluate::Evaluator;
use itm_gpu::mesh::Extract;
use itm_gpu::render::Render;
use itm_gpu::view::{ViewOptions, ViewStage};
use itm_gpu::{Device, RaycastImage, Recorder, StageTimes, View};
use itm_io::map_file::SubmapState;

use crate::Error;
use crate::atlas::Atlas;
use crate::chunked_mesh::{MeshOptions, mesh_in_chunks};
use crate::combined::Combined;
use crate::frame_result::{FrameReport, FrameResult, FrameStatus, Notice};
use crate::happening::Happening;
use crate::local::{Eyes, Local, Needs};
use crate::mapper::{Late, Mapper, Place};
use crate::places::{Places, around};
use crate::robot::Questions;
use crate::submaps::Beside;
use crate::tracking::{Against, Tracked, Tracker, Verdict, colour_offset};
use crate::warning::Warning;
use itm_reloc::{AveragePose, Keyframe, average_pose};

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
    pub(crate) view: View,
    pub(crate) evaluator: Evaluator,
    /// Tracking in the submap that frames are fused into.
    pub(crate) primary: Local,
    /// Tracking in other submaps, where the map has several.
    pub(crate) beside: Vec<Beside>,
    /// The submaps; `None` where the map is one.
    pub(crate) atlas: Option<Atlas>,
    /// The frame from which on passive submaps are looked for again.
    pub(crate) next_look: u64,
    pub(crate) needs: Needs,
    /// Where the camera has been, to find it again.
    pub(crate) places: Option<Places>,
    pub(crate) mapper: Mapper,
    pub(crate) render: Render,
    /// What the last picture was cast into, for the next one of that size.
    pub(crate) painted: Option<RaycastImage>,
    pub(crate) extract: Extract,
    pub(crate) trajectory: Trajectory,
    /// One more than the number of the last frame.
    pub(crate) next_frame: u64,
    /// What answers questions about the map; made when first asked.
    pub(crate) questions: Option<Questions>,
    /// What nobody has asked for yet.
    warnings: VecDeque<Warning>,
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
        let mapper = Mapper::new(device, calibration, settings)?;
        let places = Places::new(device, calibration, settings, &mapper.map)?;
        let mut needs = match poses {
            Poses::Tracked => Needs::of(&tracker),
            Poses::Given => Needs::nothing(),
        };
        if let Some(places) = &places {
            needs.levels = needs.levels.max(places.needs().levels);
        }
        let view_options = ViewOptions {
            depth_range_m: [settings.view.min_depth_m, settings.view.max_depth_m],
            bilateral_passes: settings.view.bilateral.passes,
            levels: needs.levels,
            vertices: settings.mode.has_surfels().then_some(settings.surfels.normal_reach_px),
            observation_weights: settings.map.observation_weight == ObservationWeight::Noise || settings.map.confidence,
            colour_levels: needs.lists.iter().flatten().map(|range| range.end).max().unwrap_or(1),
        };
        Ok(Self {
            device: device.clone(),
            calibration: *calibration,
            settings: settings.clone(),
            poses,
            view_options,
            view_stage: ViewStage::new(device),
            view: View::new(device, calibration, &view_options),
            evaluator: Evaluator::new(device),
            primary: Local::new(device, calibration, &tracker, &needs, 0)?,
            beside: Vec::new(),
            // Poses from elsewhere are those of one map.
            atlas: (settings.mode.has_submaps() && poses == Poses::Tracked && !tracker.takes_poses())
                .then(|| Atlas::new(&settings.submaps)),
            next_look: 0,
            needs,
            places,
            mapper,
            render: Render::new(device),
            painted: None,
            extract: Extract::new(device),
            trajectory: Trajectory::default(),
            next_frame: 0,
            questions: None,
            warnings: VecDeque::new(),
        })
    }

    /// The settings in force.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// What the map lies on.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// The calibration in force.
    pub fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    /// The poses so far, one for each frame that has one, as they were found.
    pub fn trajectory(&self) -> &Trajectory {
        &self.trajectory
    }

    /// The same poses as the submaps lie now, which may have moved since; the same where there is one submap.
    pub fn corrected_trajectory(&self) -> Trajectory {
        self.atlas.as_ref().map_or_else(|| self.trajectory.clone(), Atlas::trajectory)
    }

    /// Blocks that the map can hold before its pools grow.
    pub fn capacity(&self) -> u32 {
        self.mapper.map.capacity()
    }

    /// The places that are remembered, to find the camera again; see [`itm_core::RelocaliserSettings`].
    pub fn keyframes(&self) -> &[Keyframe] {
        self.places.as_ref().map_or(&[], |places| places.relocaliser.keyframes())
    }

    /// Bytes of device memory that the map takes.
    pub fn map_bytes(&self) -> u64 {
        let surfels = self.mapper.surfels.as_ref().map_or(0, |surfels| surfels.map.device_bytes());
        self.mapper.map.device_bytes() + surfels
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

    /// What was no use and was left out, the earliest first, each told once; `None` where all was told.
    pub fn next_warning(&mut self) -> Option<Warning> {
        self.warnings.pop_front()
    }

    pub(crate) fn warn(&mut self, warning: Warning) {
        tracing::warn!("{warning}");
        self.warnings.push_back(warning);
    }

    /// Goes on in the submap that there is, where another one finds no room.
    pub(crate) fn no_room_for_submap(&mut self, error: Error) -> Result<(), Error> {
        use itm_gpu::Error::{OutOfMemory, TooManyBlocks};
        let Error::Gpu(reason @ (TooManyBlocks { .. } | OutOfMemory { .. })) = error else { return Err(error) };
        self.warn(Warning::NoFurtherSubmap { reason: reason.to_string() });
        Ok(())
    }

    /// Leaves out submaps all of whose blocks were removed, where any can be.
    pub(crate) fn leave_out_emptied(&mut self) -> Result<(), Error> {
        if self.mapper.removes_blocks() { self.leave_out_without_blocks(Some(self.primary.submap)) } else { Ok(()) }
    }

    /// Leaves out submaps without blocks, but for the one that frames are fused into: no keyframe leads there any more.
    pub(crate) fn leave_out_without_blocks(&mut self, primary: Option<u16>) -> Result<(), Error> {
        if self.submaps().len() < 2 {
            return Ok(());
        }
        let there = self.mapper.submaps()?;
        let gone = self.atlas.as_mut().map(|atlas| atlas.note_blocks(&there, primary)).unwrap_or_default();
        for submap in gone {
            let keyframes = self.places.as_mut().map_or(0, |places| places.relocaliser.remove_submap(submap));
            self.warn(Warning::SubmapWithoutBlocks { submap, keyframes });
        }
        Ok(())
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
        self.primary.motion.sense(frame);
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
        self.primary.motion.sense(frame);
        let pose = Se3::try_from_quaternion(world_from_camera.rotation, world_from_camera.translation);
        let located = if let Ok(world_from_camera) = &pose {
            let pose = self.to_primary(world_from_camera);
            Located { pose: Some(pose), fuse: true, ..Located::without(FrameStatus::Placed) }
        } else {
            Located::without(FrameStatus::NoPose)
        };
        self.conclude(frame, located, view_times, 0.0, report)
    }

    /// Says that the next frame does not follow the last one: the camera may have been moved by hand, or the recording is gone
    /// on with elsewhere. It is looked for where it was last, as if it had stood still since.
    pub fn interrupt(&mut self) {
        self.primary.motion.interrupt();
        for beside in &mut self.beside {
            beside.local.motion.interrupt();
        }
    }

    /// Finds a frame's pose in the map from certain poses, and leaves everything as it is; `None` without a map.
    ///
    /// # Errors
    /// As [`Slam::process`], and where the session's poses are given.
    pub fn probe(&mut self, frame: &Frame, starts: &[Se3]) -> Result<Option<Tracked>, Error> {
        if self.poses == Poses::Given {
            return Err(Error::PosesAreGiven);
        }
        let _untimed = self.look(frame)?;
        let learnt = self.primary.tracker.learnt();
        let (local, mut eyes) = self.local_and_eyes();
        let found = local.track_from(&mut eyes, frame, starts);
        local.tracker.learn(&learnt);
        found
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
        if let Some(places) = &mut self.places {
            places.look(&mut recorder, &self.view);
        }
        Ok(recorder.submit())
    }

    /// Where the frame's camera is, and what is to become of the frame.
    fn locate(&mut self, frame: &Frame) -> Result<Located, Error> {
        if self.poses == Poses::Given {
            let pose = frame.world_from_camera.filter(Se3::is_finite);
            let status = if pose.is_some() { FrameStatus::Placed } else { FrameStatus::NoPose };
            return Ok(Located { pose, fuse: true, ..Located::without(status) });
        }
        let Some(world_from_model) = self.primary.submap_from_model else {
            if !self.mapper.is_empty() {
                let lost = "no keyframe of the map is where the camera is".to_owned();
                return Ok(self.relocalise(frame)?.unwrap_or(Located::without(FrameStatus::Lost { reason: lost })));
            }
            let pose = self.first_pose(frame)?;
            let status = if pose.is_some() { FrameStatus::Placed } else { FrameStatus::NoPose };
            return Ok(Located { pose, fuse: true, ..Located::without(status) });
        };
        let settings = &self.settings.tracker;
        let on_failure = settings.on_failure;
        let after_loss = settings.verdict.frames_to_recover + 1;
        // What was found after a loss may be wrong, so the search goes on until frames are good again.
        let searching = on_failure == OnFailure::Relocalise && self.primary.to_recover > 0;
        let mut further = if searching { around(&world_from_model) } else { Vec::new() };
        if self.primary.motion.last().is_none() {
            // In a saved map no frame has come before.
            further.insert(0, world_from_model);
        }
        let (local, mut eyes) = self.local_and_eyes();
        let tracked = local.track(&mut eyes, frame, &further)?.expect("there is a model");
        let pose = Some(tracked.world_from_camera);
        let reason = tracked.reasons.join("; ");
        let settings = &self.settings.tracker;
        let located = match tracked.verdict {
            Verdict::Good if self.primary.to_recover > 1 => {
                self.primary.to_recover -= 1;
                let left = self.primary.to_recover;
                let reason = format!("tracked again after a loss; fused after {left} more good frames");
                Located { tracked: Some(tracked), pose, ..Located::without(FrameStatus::Poor { reason }) }
            }
            Verdict::Good => {
                self.primary.to_recover = 0;
                self.primary.last_good = pose;
                Located { tracked: Some(tracked), pose, fuse: true, ..Located::without(FrameStatus::Tracked) }
            }
            Verdict::Poor => {
                let fuse = settings.verdict.fuse_poor && self.primary.to_recover == 0;
                if self.primary.to_recover > 0 {
                    // It may have come to rest beside where it is, where no start from nearby leads away from.
                    if searching && let Some(found) = self.relocalise(frame)? {
                        return Ok(found);
                    }
                    // Good ones must come in a row; but it is no longer lost.
                    self.primary.to_recover = after_loss - 1;
                }
                Located { tracked: Some(tracked), pose, fuse, ..Located::without(FrameStatus::Poor { reason }) }
            }
            Verdict::Lost if on_failure == OnFailure::Ignore => {
                let pose = Some(world_from_model);
                Located { tracked: Some(tracked), pose, fuse: true, ..Located::without(FrameStatus::Lost { reason }) }
            }
            Verdict::Lost => {
                let mut happenings = Vec::new();
                if let Some(found) = self.fall_back(frame, &mut happenings)? {
                    let pose = Some(found.world_from_camera);
                    let tracked = Some(found);
                    return Ok(Located {
                        tracked,
                        pose,
                        fuse: true,
                        happenings,
                        ..Located::without(FrameStatus::Tracked)
                    });
                }
                let relocalises = on_failure == OnFailure::Relocalise;
                if relocalises && let Some(found) = self.relocalise(frame)? {
                    return Ok(found);
                }
                self.primary.to_recover = if relocalises { after_loss } else { 0 };
                self.return_to_last_good()?;
                Located { tracked: Some(tracked), ..Located::without(FrameStatus::Lost { reason }) }
            }
        };
        Ok(located)
    }

    /// Looks for a frame's place in the map by its keyframes alone, and leaves everything as it is.
    ///
    /// # Errors
    /// As [`Slam::process`].
    pub fn find(&mut self, frame: &Frame) -> Result<Sighting, Error> {
        let _untimed = self.look(frame)?;
        let Self { device, places, mapper, evaluator, view, calibration, settings, .. } = self;
        let Some(places) = places else { return Ok(Sighting::default()) };
        let mut eyes = Eyes { evaluator, view, calibration, settings };
        let (candidates, found) = places.find_anywhere(device, mapper, &mut eyes, frame)?;
        Ok(Sighting {
            resembles: candidates.first().map(|candidate| candidate.keyframe),
            average: average_pose(&candidates, &settings.relocaliser),
            found: found.map(|found| (found.candidate.keyframe, found.tracked)),
        })
    }

    /// Finds the frame among the places that the camera has been at. It is followed, but fused only once further frames are
    /// good.
    fn relocalise(&mut self, frame: &Frame) -> Result<Option<Located>, Error> {
        self.leave_out_emptied()?;
        let Self { device, places, mapper, evaluator, view, calibration, settings, .. } = self;
        let Some(places) = places else { return Ok(None) };
        let mut eyes = Eyes { evaluator, view, calibration, settings };
        let (_, Some(found)) = places.find_anywhere(device, mapper, &mut eyes, frame)? else { return Ok(None) };
        let mut happenings = vec![found.happening()];
        self.return_to(found.candidate.keyframe.submap, &mut happenings)?;
        let (primary, happening) = (&mut self.primary, found.happening());
        primary.motion.forget();
        primary.to_recover = self.settings.tracker.verdict.frames_to_recover;
        let left = primary.to_recover;
        let fuse = left == 0;
        let reason = format!("{happening}; fused after {left} more good frames");
        let status = if fuse { FrameStatus::Tracked } else { FrameStatus::Poor { reason } };
        let pose = Some(found.tracked.world_from_camera);
        Ok(Some(Located { status, tracked: Some(found.tracked), pose, fuse, happenings }))
    }

    /// Tracking begins at a pose in the world.
    pub(crate) fn start_in_world(&mut self, world_from_camera: &Se3) -> Result<(), Error> {
        let far_m = f64::from(self.settings.view.max_depth_m);
        let Some(atlas) = &mut self.atlas else { return self.start_at(world_from_camera) };
        let submap = atlas.seen_best_from(&self.calibration.depth, world_from_camera, far_m);
        atlas.set_state(submap, SubmapState::Primary);
        self.primary.submap = submap;
        let pose = atlas.world_from(submap).inverse() * *world_from_camera;
        self.start_at(&pose)
    }

    /// Tracking begins at a pose in the primary submap.
    pub(crate) fn start_at(&mut self, world_from_camera: &Se3) -> Result<(), Error> {
        self.mapper.cast_for_tracking(self.primary.submap, &mut self.primary.model, world_from_camera)?;
        self.primary.submap_from_model = Some(*world_from_camera);
        self.primary.last_good = self.primary.submap_from_model;
        let mut recorder = Recorder::new(&self.device);
        self.record_map_list(&mut recorder, world_from_camera);
        let _untimed = recorder.submit();
        Ok(())
    }

    /// Where the world begins: at the first camera, unless poses come from files.
    fn first_pose(&self, frame: &Frame) -> Result<Option<Se3>, Error> {
        self.primary.tracker.pose_from_file(frame).unwrap_or(Ok(Some(Se3::IDENTITY)))
    }

    /// Tracking goes on from the last pose that could be relied on.
    fn return_to_last_good(&mut self) -> Result<(), Error> {
        let Some(last_good) = self.primary.last_good else { return Ok(()) };
        self.primary.motion.return_to(last_good);
        if self.primary.submap_from_model != Some(last_good) {
            self.mapper.cast_for_tracking(self.primary.submap, &mut self.primary.model, &last_good)?;
            self.primary.submap_from_model = Some(last_good);
            // The frame before was taken elsewhere.
            let mut recorder = Recorder::new(&self.device);
            if let Some(list) = self.primary.list(Against::Previous) {
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
        let Located { mut status, tracked, mut pose, mut fuse, mut happenings } = located;
        // Where the map is only looked at.
        fuse &= self.settings.map.fuse;
        self.next_frame = frame.index.saturating_add(1);
        let mut fused = false;
        if let Some(at) = pose
            && self.atlas.is_some()
        {
            let before = self.primary.motion.last();
            pose = Some(self.tend(frame, before, at, tracked.as_ref(), &mut happenings)?);
        }
        if let Some(world_from_camera) = pose {
            let lead = self.primary.motion.colour_lead(frame, &self.settings.view);
            let offset = colour_offset(&self.primary.motion.last(), &world_from_camera, lead);
            let colour_from_depth = self.calibration.colour_from_depth * offset.inverse();
            if fuse {
                let times = vec![view_times];
                if matches!(status, FrameStatus::Tracked | FrameStatus::Placed)
                    && let Some(places) = &mut self.places
                {
                    // Before anything more is recorded, so that it waits for nothing else.
                    let (submap, time) = (self.primary.submap, frame.timestamp);
                    happenings.extend(places.remember(&self.device, submap, &world_from_camera, time)?);
                }
                let submap = self.primary.submap;
                let submap_from_model = self.primary.submap_from_model;
                let place =
                    Place { submap, submap_from_camera: world_from_camera, colour_from_depth, submap_from_model };
                fused = self.mapper.fuse(frame.index, &self.view, &place, &mut self.primary.model, times)?;
                if !fused {
                    (status, pose) = (FrameStatus::NoDepth, None);
                }
            } else {
                self.mapper.follow(self.primary.submap, &mut self.primary.model, &world_from_camera)?;
            }
            if let Some(world_from_camera) = pose {
                if fused {
                    self.note_central(&world_from_camera)?;
                }
                self.primary.age.frames += u64::from(fused);
                self.primary.submap_from_model = Some(world_from_camera);
                if matches!(status, FrameStatus::Placed) {
                    self.primary.last_good = pose;
                }
                self.primary.motion.moved_to(frame, world_from_camera);
                self.list_colours(&(world_from_camera * colour_from_depth.inverse()), &world_from_camera);
                let world_from_camera = self.to_world(&world_from_camera);
                self.trajectory.push(StampedPose { timestamp: frame.timestamp, world_from_camera });
            }
        }
        Ok(FrameResult {
            index: frame.index,
            timestamp: frame.timestamp,
            world_from_camera: pose.map(|pose| self.to_world(&pose)),
            submap: self.primary.submap,
            status,
            tracked,
            fused,
            track_ms,
            happenings,
            report,
        })
    }

    /// Tracking in the primary submap, and what it looks with.
    fn local_and_eyes(&mut self) -> (&mut Local, Eyes<'_>) {
        let Self { primary, evaluator, view, calibration, settings, .. } = self;
        (primary, Eyes { evaluator, view, calibration, settings })
    }

    /// Lists the model's points with their colours for the next frame's tracking.
    fn list_colours(&self, world_from_colour: &Se3, world_from_camera: &Se3) {
        if self.primary.lists.iter().all(Option::is_none) {
            return;
        }
        let mut recorder = Recorder::new(&self.device);
        if let Some(list) = self.primary.list(Against::Previous) {
            let stage = &self.evaluator.photometric;
            stage.list_previous(&mut recorder, list, &self.primary.model.image, &self.view, world_from_colour, 0.0);
        }
        self.record_map_list(&mut recorder, world_from_camera);
        let _untimed = recorder.submit();
    }

    fn record_map_list(&self, recorder: &mut Recorder, world_from_camera: &Se3) {
        if let Some(list) = self.primary.list(Against::Map) {
            let (stage, image) = (&self.evaluator.photometric, &self.primary.model.image);
            match &self.mapper.surfels {
                Some(surfels) => stage.list_surfels(recorder, list, image, surfels.drawn(), world_from_camera),
                None => stage.list_map(recorder, list, image, &self.mapper.map, world_from_camera, 0.0),
            }
        }
    }

    fn report(&self, late: Late) -> FrameReport {
        let Late { frame, record, stage_ms, surfels } = late;
        let mut notices = Vec::new();
        if let Some(record) = surfels.filter(|record| record.dropped > 0) {
            let capacity = self.mapper.surfels.as_ref().map_or(0, |surfels| surfels.map.capacity());
            notices.push(Notice::SurfelsDropped { surfels: record.dropped, capacity });
        }
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
        FrameReport { index: frame, record, surfels, stage_ms, notices }
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
        let count = |n: u64| u32::try_from(n).unwrap_or(u32::MAX);
        let mut told = |done, of| progress(count(done), count(of));
        if self.mapper.surfels.is_some() {
            return self.mesh_of_surfels(progress);
        }
        if self.submaps().len() > 1 {
            return self
                .with_combined(|combined| mesh_in_chunks(&device, combined, &MeshOptions::default(), &mut told));
        }
        if let Some(mut live) = self.mapper.live()? {
            return mesh_in_chunks(&device, &mut live, &MeshOptions::default(), &mut told);
        }
        Ok(self.extract.run(&self.mapper.map, &itm_gpu::mesh::Options::default(), progress)?)
    }

    /// Optimises the submaps' poses with all that is known, at the end of a run; what was done, where there is more than one and
    /// frames are fused.
    pub fn settle(&mut self) -> Option<Happening> {
        self.atlas.as_mut().filter(|atlas| atlas.submaps.len() > 1 && self.settings.map.fuse)?.finish()
    }

    /// Does something with the submaps' blocks as one map's.
    pub(crate) fn with_combined<T>(
        &mut self,
        with: impl FnOnce(&mut Combined<'_>) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let (poses, largest) = (self.submap_poses(), crate::views::full_weight(&self.settings));
        self.mapper.read_moved()?;
        let mut live = self.mapper.live_map()?;
        with(&mut Combined::new(&mut live, &poses, largest)?)
    }
}

/// What the keyframes say about where a frame's camera is.
#[derive(Clone, Debug, Default)]
pub struct Sighting {
    /// The keyframe that the frame resembles most, wherever the camera is.
    pub resembles: Option<Keyframe>,
    /// The mean of its pose and those of other similar keyframes near it; see [`itm_reloc::average_pose`].
    pub average: Option<AveragePose>,
    /// Where the camera is, in the submap of the keyframe that led there.
    pub found: Option<(Keyframe, Tracked)>,
}

/// Where a frame's camera is, and what is to become of the frame.
struct Located {
    status: FrameStatus,
    tracked: Option<Tracked>,
    pose: Option<Se3>,
    /// Whether the frame is fused at its pose.
    fuse: bool,
    happenings: Vec<Happening>,
}

impl Located {
    fn without(status: FrameStatus) -> Self {
        Self { status, tracked: None, pose: None, fuse: false, happenings: Vec::new() }
    }
}
