//! The map's life: when pools grow, and which stages a frame's fusion takes.

use std::collections::VecDeque;

use itm_core::voxel::{BEST_OBSERVATION, VoxelKind};
use itm_core::{Calibration, Intrinsics, ObservationWeight, Se3, Settings};
use itm_gpu::allocate::Allocate;
use itm_gpu::confidence::Confidence;
use itm_gpu::integrate::{Integrate, IntegrateOptions};
use itm_gpu::normals::Normals;
use itm_gpu::ranges::Ranges;
use itm_gpu::raycast::Raycast;
use itm_gpu::visible::Visible;
use itm_gpu::{
    BlockMap, Device, Error, FrameRecord, MapLayout, RaycastImage, RecordReader, Recorder, StageTimes, View,
};

/// A frame's record is consumed at this many frames later, whenever it arrived, so that growth happens at the same frame
/// in every run.
const RECORD_DELAY: u64 = 2;

/// The map and the stages that fill and show it.
pub(crate) struct Mapper {
    device: Device,
    calibration: Calibration,
    settings: Settings,
    pub(crate) map: BlockMap,
    allocate: Allocate,
    visible: Visible,
    integrate: Integrate,
    ranges: Ranges,
    raycast: Raycast,
    normals: Normals,
    confidence: Confidence,
    waiting: VecDeque<Waiting>,
    /// Largest number of blocks that one frame asked for lately; decays.
    demand: u32,
    /// Whether nothing has been fused yet.
    empty: bool,
    /// Frames that have come so far. (A frame's own index is the caller's, and may start and jump as it likes.)
    frames: u64,
    /// Blocks that the map may grow to.
    limit: u32,
}

struct Waiting {
    /// The frame's place among those that came.
    place: u64,
    /// The frame's own index.
    frame: u64,
    record: RecordReader,
    times: Vec<StageTimes>,
}

/// What became known of a frame `RECORD_DELAY` frames later.
pub(crate) struct Late {
    pub(crate) frame: u64,
    pub(crate) record: FrameRecord,
    pub(crate) stage_ms: Vec<(&'static str, f64)>,
}

impl Mapper {
    pub(crate) fn new(device: &Device, calibration: &Calibration, settings: &Settings) -> Result<Self, Error> {
        let layout = MapLayout {
            voxel_size_m: settings.map.voxel_size_m,
            truncation_m: settings.map.truncation_m,
            kind: VoxelKind {
                distance: settings.map.distance,
                colour: settings.map.colour && settings.view.colour,
                confidence: settings.map.confidence,
            },
        };
        let mut map = BlockMap::new(device, layout, 1)?;
        let limit = match settings.map.max_blocks {
            0 => map.max_capacity(),
            limit => limit.min(map.max_capacity()),
        };
        map.grow(settings.map.initial_blocks.min(limit))?;
        map.check_view(&calibration.depth, settings.view.max_depth_m, settings.map.truncation_m)?;
        Ok(Self {
            device: device.clone(),
            calibration: *calibration,
            settings: settings.clone(),
            map,
            allocate: Allocate::new(device),
            visible: Visible::new(device),
            integrate: Integrate::new(device),
            ranges: Ranges::new(device),
            raycast: Raycast::new(device),
            normals: Normals::new(device),
            confidence: Confidence::new(device),
            waiting: VecDeque::new(),
            demand: 0,
            empty: true,
            frames: 0,
            limit,
        })
    }

    /// Takes over what an earlier frame's record says. Called once a frame, before anything is allocated.
    pub(crate) fn consume(&mut self) -> Result<Option<Late>, Error> {
        self.frames += 1;
        let due = self.waiting.front().is_some_and(|w| w.place + RECORD_DELAY <= self.frames);
        let Some(waiting) = due.then(|| self.waiting.pop_front()).flatten() else { return Ok(None) };
        let late = self.take(waiting)?;
        self.demand = late.record.requested.max(self.demand - self.demand / 8);
        self.make_room(&late.record)?;
        Ok(Some(late))
    }

    /// Everything that has not been consumed yet, at the end of a run.
    pub(crate) fn drain(&mut self) -> Result<Vec<Late>, Error> {
        let waiting = std::mem::take(&mut self.waiting);
        waiting.into_iter().map(|w| self.take(w)).collect()
    }

    fn take(&mut self, waiting: Waiting) -> Result<Late, Error> {
        let record = waiting.record.read(&self.device)?;
        let mut stage_ms = Vec::new();
        for times in waiting.times {
            stage_ms.extend(times.read(&self.device)?);
        }
        Ok(Late { frame: waiting.frame, record, stage_ms })
    }

    /// Whether the map holds all the blocks that it may.
    pub(crate) fn is_full(&self, record: &FrameRecord) -> bool {
        self.map.capacity() >= self.limit && record.blocks - record.free_blocks >= self.limit
    }

    /// Grows the pools so that the frames until the next record find room, as far as limits allow.
    fn make_room(&mut self, record: &FrameRecord) -> Result<(), Error> {
        let used = record.blocks - record.free_blocks;
        // Requests of the frames since, of this one and of the next, with as much again to spare.
        let spare = self.demand.saturating_mul(2 * (RECORD_DELAY as u32 + 1));
        let needed = used.saturating_add(record.pending).saturating_add(spare);
        let capacity = self.map.capacity();
        if needed <= capacity || capacity >= self.limit {
            return Ok(());
        }
        let wanted = needed.max(capacity + capacity / 4).min(self.limit);
        tracing::debug!(from = capacity, to = wanted, "the block pools grow");
        match self.map.grow(wanted) {
            Err(Error::OutOfMemory { reason }) => {
                // The map goes on as large as it is; frames say what finds no room.
                tracing::warn!(capacity, reason, "the map cannot grow: the device has no memory left");
                self.limit = capacity;
                Ok(())
            }
            grown => grown,
        }
    }

    /// Fuses a view into the map, whose colour camera lies at `colour_from_depth` beside the depth camera, and casts the map
    /// into `model` for the next frame's tracking. `times` are those of the
    /// frame's earlier stages. Returns whether there is a map: a view without depth cannot begin one.
    pub(crate) fn fuse(
        &mut self,
        frame: u64,
        view: &View,
        world_from_camera: &Se3,
        colour_from_depth: &Se3,
        model: &RaycastImage,
        mut times: Vec<StageTimes>,
    ) -> Result<bool, Error> {
        let camera = self.calibration.depth;
        let [near_m, far_m] = [self.settings.view.min_depth_m, self.settings.view.max_depth_m];
        let truncation_m = self.settings.map.truncation_m;
        self.map.lay_grid(&camera, world_from_camera, far_m, truncation_m)?;
        if self.empty {
            // The first frame asks for more blocks than any other. Nothing waits for it yet, so room is made at once.
            let mut recorder = Recorder::new(&self.device);
            self.allocate.record(&mut recorder, &self.map, view, world_from_camera);
            let _untimed = recorder.submit();
            let record = self.map.read_record()?;
            if record.requested == 0 {
                return Ok(false);
            }
            self.empty = false;
            // Later frames see mostly what this one has seen.
            self.demand = record.requested / 8;
            self.make_room(&record)?;
        }
        let mut recorder = Recorder::timed(&self.device);
        self.allocate.record(&mut recorder, &self.map, view, world_from_camera);
        let (near, far) = (f32::max(near_m - truncation_m, 0.0), far_m + truncation_m);
        self.visible.record(&mut recorder, &self.map, &camera, world_from_camera, near, far);
        // A largest weight of so many of the best observations.
        let best = match self.settings.map.observation_weight {
            ObservationWeight::Constant => 1,
            ObservationWeight::Noise => BEST_OBSERVATION,
        };
        let options = IntegrateOptions {
            max_weight: self.settings.map.max_weight.saturating_mul(best),
            stop_at_max_weight: self.settings.map.stop_at_max_weight,
            colour_band: self.settings.map.colour_band,
            empty_loss: self.settings.map.empty_loss.saturating_mul(best),
            weighted: self.settings.map.observation_weight == ObservationWeight::Noise,
        };
        let calibration = Calibration { colour_from_depth: *colour_from_depth, ..self.calibration };
        self.integrate.record(&mut recorder, &self.map, view, &calibration, world_from_camera, &options);
        self.ranges.record(&mut recorder, &self.map, model, world_from_camera);
        self.raycast.record(&mut recorder, &self.map, model, world_from_camera, [near_m, far]);
        self.normals.record(&mut recorder, model, world_from_camera);
        self.confidence.record(&mut recorder, &self.map, model);
        let record = self.map.record_counters(&mut recorder);
        times.push(recorder.submit());
        self.waiting.push_back(Waiting { place: self.frames, frame, record, times });
        Ok(true)
    }

    /// Casts the map as a camera sees it from a pose, up to a depth. The next frame's fusion is not affected.
    pub(crate) fn cast(
        &mut self,
        camera: &Intrinsics,
        world_from_camera: &Se3,
        max_depth_m: f32,
    ) -> Result<RaycastImage, Error> {
        let image = RaycastImage::new(&self.device, *camera)?;
        self.cast_into(&image, world_from_camera, max_depth_m)?;
        Ok(image)
    }

    /// The same, into an image.
    pub(crate) fn cast_into(
        &mut self,
        image: &RaycastImage,
        world_from_camera: &Se3,
        max_depth_m: f32,
    ) -> Result<(), Error> {
        let camera = image.camera();
        self.map.lay_grid(camera, world_from_camera, max_depth_m, 0.0)?;
        let mut recorder = Recorder::new(&self.device);
        self.allocate.fill_grid(&mut recorder, &self.map);
        self.visible.record(&mut recorder, &self.map, camera, world_from_camera, 0.0, max_depth_m);
        self.ranges.record(&mut recorder, &self.map, image, world_from_camera);
        self.raycast.record(&mut recorder, &self.map, image, world_from_camera, [0.01, max_depth_m]);
        self.normals.record(&mut recorder, image, world_from_camera);
        self.confidence.record(&mut recorder, &self.map, image);
        let _untimed = recorder.submit();
        Ok(())
    }
}
