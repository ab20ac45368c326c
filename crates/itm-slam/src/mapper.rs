//! The map's life: when pools grow, and which stages a frame's fusion takes.

mod taking_in;

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use glam::{DVec3, IVec3, UVec3};
use itm_core::voxel::{BEST_OBSERVATION, BLOCK_SIDE, BlockKey, VoxelKind};
use itm_core::{Calibration, DenseSettings, Intrinsics, MapIndex, ObservationWeight, Se3, Settings, Swapping};
use itm_gpu::changed::Changed;
use itm_gpu::forward::Forward;
use itm_gpu::hash::Hash;
use itm_gpu::integrate::{Integrate, IntegrateOptions};
use itm_gpu::swap::{AGE_BINS, Arrivals, Gather, Left, PlacesReader, Swap, Transfer};
use itm_gpu::{
    BlockMap, Device, FrameRecord, MapLayout, MapState, RaycastImage, RecordReader, Recorder, StageTimes, SurfelRecord,
    View,
};
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::caster::{Caster, NEAR_M};
use crate::live::LiveMap;
use crate::surfels::{LateSurfels, Surfels, SurfelsState};
use crate::swapping::{InMotion, Moved, Swapped, Viewed};

/// A frame's record is consumed at this many frames later, whenever it arrived, so that growth happens at the same frame
/// in every run.
const RECORD_DELAY: u64 = 2;
/// So often, in frames, blocks that hold nothing any more are removed, and so many at once.
const SWEEP_EVERY: u64 = 30;
const SWEPT_AT_ONCE: u32 = 4096;

/// The map and the stages that fill and show it.
pub(crate) struct Mapper {
    device: Device,
    /// The map where it is one of surfels: the blocks stay empty then.
    pub(crate) surfels: Option<Surfels>,
    calibration: Calibration,
    settings: Settings,
    pub(crate) map: BlockMap,
    caster: Caster,
    /// Projects the last frame's points, where the settings ask for it.
    forward: Option<Forward>,
    integrate: Integrate,
    waiting: VecDeque<Waiting>,
    /// Largest number of blocks that one frame asked for lately; decays.
    demand: u32,
    /// Whether nothing has been fused yet.
    empty: bool,
    /// Whether the next frame is the first of a submap, which asks for as many blocks as a map's first.
    beginning: bool,
    /// Whether a further submap may begin: a dense one may find no room.
    may_begin: bool,
    /// Frames that have come so far. (A frame's own index is the caller's, and may start and jump as it likes.)
    frames: u64,
    /// Blocks that the map may grow to.
    limit: u32,
    /// The host's part of the map, where blocks may leave the device.
    pub(crate) swapped: Option<Swapped>,
    /// Removes blocks that hold nothing any more, where surfaces that are seen through are forgotten.
    sweep: Option<(Swap, Transfer)>,
    /// Views that blocks were swapped for so far; ages count them.
    clock: u32,
    /// What the next frame has leave: how many at most, and from which age on.
    leaving: Option<(u32, u32)>,
    /// Whether the hash holds so many traces of removed blocks that it is to be rebuilt.
    rebuild: bool,
    hash: Hash,
    gather: Gather,
    /// Where blocks remember what changed them.
    changed: Option<Changed>,
    /// Boxes that each submap's blocks all lie in, by their first and last ones; `None` where that is to be found out.
    extents: Option<BTreeMap<u16, [IVec3; 2]>>,
}

/// A submap as tracking sees it.
#[derive(Debug)]
pub(crate) struct Model {
    pub(crate) image: RaycastImage,
    /// Frames since it was last cast in full, and the camera's centre then.
    pub(crate) full_cast: Option<(u32, DVec3)>,
}

impl Model {
    pub(crate) fn new(image: RaycastImage) -> Self {
        Self { image, full_cast: None }
    }
}

/// Where a frame is fused.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    pub(crate) submap: u16,
    pub(crate) submap_from_camera: Se3,
    /// Where the colour camera was, beside the depth camera, when its image was taken.
    pub(crate) colour_from_depth: Se3,
    /// The pose that the model was last cast from, if it was.
    pub(crate) submap_from_model: Option<Se3>,
}

struct Waiting {
    /// The frame's place among those that came.
    place: u64,
    /// The frame's own index.
    frame: u64,
    found: Found,
    times: Vec<StageTimes>,
    most_leaving: u32,
    /// Whether it has been told already what became of the frame.
    reported: bool,
}

/// What a frame left behind on the device.
enum Found {
    /// To be read.
    OnDevice(RecordReader, Box<InMotion>),
    /// Read, but not taken over yet: that happens at its frame.
    Read(FrameRecord, Moved),
}

/// A [`Mapper`]'s state as it is saved.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct MapperState {
    pub(crate) capacity: u32,
    demand: u32,
    empty: bool,
    #[serde(default)]
    beginning: bool,
    frames: u64,
    limit: u32,
    clock: u32,
    leaving: Option<(u32, u32)>,
    rebuild: bool,
    ages: Vec<u32>,
    near: u32,
    arriving: Vec<[u32; 2]>,
    waiting: Vec<WaitingState>,
    #[serde(default)]
    pub(crate) surfels: Option<SurfelsState>,
}

#[derive(Debug, Serialize, Deserialize)]
struct WaitingState {
    place: u64,
    frame: u64,
    record: [u32; 8],
    most_leaving: u32,
    ages: Option<Vec<u32>>,
    /// How many blocks left; they lie in the file in the order of their frames.
    left: Option<usize>,
    /// Which blocks were brought, and whether each found room.
    brought: Option<Vec<([u32; 2], bool)>>,
}

impl Waiting {
    fn read(&mut self, device: &Device) -> Result<(&FrameRecord, &mut Moved), Error> {
        let found = match std::mem::replace(&mut self.found, Found::nothing()) {
            Found::OnDevice(record, motion) => Found::Read(record.read(device)?, motion.read(device)?),
            read @ Found::Read(..) => read,
        };
        self.found = found;
        match &mut self.found {
            Found::Read(record, moved) => Ok((record, moved)),
            Found::OnDevice(..) => unreachable!("it was just read"),
        }
    }

    /// What became known of the frame, told once.
    fn late(&mut self, device: &Device) -> Result<Late, Error> {
        self.reported = true;
        let record = *self.read(device)?.0;
        let mut stage_ms = Vec::new();
        for times in self.times.drain(..) {
            stage_ms.extend(times.read(device)?);
        }
        Ok(Late { frame: self.frame, record, stage_ms, surfels: None })
    }
}

impl Found {
    fn nothing() -> Self {
        Self::Read(FrameRecord::default(), Moved::default())
    }
}

/// What became known of a frame `RECORD_DELAY` frames later.
pub(crate) struct Late {
    pub(crate) frame: u64,
    pub(crate) record: FrameRecord,
    pub(crate) stage_ms: Vec<(&'static str, f64)>,
    /// The surfels' counters, where the map is one of surfels.
    pub(crate) surfels: Option<SurfelRecord>,
}

impl From<LateSurfels> for Late {
    fn from(late: LateSurfels) -> Self {
        let LateSurfels { frame, record, stage_ms } = late;
        Self { frame, record: FrameRecord::default(), stage_ms, surfels: Some(record) }
    }
}

/// Grows a map's pools so that they have room for what is needed, as far as limits allow. Where the device has no memory left the map
/// goes on as large as it is, which is its limit from then on; frames say what finds no room.
pub(crate) fn grow_pools(
    what: &'static str,
    needed: u32,
    capacity: u32,
    limit: &mut u32,
    grow: impl FnOnce(u32) -> Result<(), itm_gpu::Error>,
) -> Result<(), Error> {
    if needed <= capacity || capacity >= *limit {
        return Ok(());
    }
    let wanted = needed.max(capacity + capacity / 4).min(*limit);
    tracing::debug!(what, from = capacity, to = wanted, "the map's pools grow");
    match grow(wanted) {
        Err(itm_gpu::Error::OutOfMemory { reason }) => {
            tracing::warn!(what, capacity, reason, "the map cannot grow: the device has no memory left");
            *limit = capacity;
            Ok(())
        }
        grown => Ok(grown?),
    }
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
        let budget_bytes = settings.map.device_budget_mib * f64::from(1 << 20);
        let limit = match (budget_bytes / layout.kind.block_bytes() as f64) as u32 {
            0 if budget_bytes == 0.0 => map.max_capacity(),
            limit => limit.clamp(1, map.max_capacity()),
        };
        let of_surfels = settings.mode.has_surfels();
        map.grow(if of_surfels { 1 } else { settings.map.initial_blocks.min(limit) })?;
        let dense = settings.map.index == MapIndex::Dense && !of_surfels;
        if dense {
            map.insert_empty(&blocks_of_box(0, &settings.map.dense))?;
        }
        let swaps = settings.map.swapping != Swapping::Off && !dense && !of_surfels;
        let margin_m = if swaps { settings.map.swap_margin_m } else { 0.0 };
        map.check_view(&calibration.depth, settings.view.max_depth_m, settings.map.truncation_m.max(margin_m))?;
        let swapped = swaps.then(|| Swapped::new(device, &map, &settings.map, largest_weight(settings))).transpose()?;
        let map_capacity = map.capacity();
        let sweeps = settings.map.empty_loss > 0 && !dense && !of_surfels;
        let sweep = sweeps.then(|| (Swap::new(device), Transfer::new(device, &map, SWEPT_AT_ONCE)));
        Ok(Self {
            device: device.clone(),
            surfels: of_surfels.then(|| Surfels::new(device, calibration, settings)).transpose()?,
            calibration: *calibration,
            settings: settings.clone(),
            map,
            caster: Caster::new(device),
            forward: settings.tracker.forward_projection.enabled.then(|| Forward::new(device, &calibration.depth)),
            integrate: Integrate::new(device),
            waiting: VecDeque::new(),
            demand: 0,
            empty: true,
            beginning: false,
            may_begin: true,
            frames: 0,
            limit: if dense { map_capacity } else { limit },
            swapped,
            sweep,
            clock: 0,
            leaving: None,
            rebuild: false,
            hash: Hash::new(device),
            gather: Gather::new(device),
            changed: settings.map.track_changes.then(|| Changed::new(device)),
            extents: (!dense).then(BTreeMap::new),
        })
    }

    /// Takes over what is read for each frame; buffers stay as they are.
    pub(crate) fn change_settings(&mut self, settings: &Settings) {
        if let Some(swapped) = &mut self.swapped {
            swapped.max_weight = largest_weight(settings);
        }
        if let Some(surfels) = &mut self.surfels {
            surfels.settings = settings.clone();
        }
        self.settings = settings.clone();
    }

    /// What the next frames depend on beside the map and the host's store; reads what is on its way.
    pub(crate) fn state(&mut self) -> Result<MapperState, Error> {
        let mut waiting = Vec::new();
        for frame in &mut self.waiting {
            let (record, moved) = frame.read(&self.device)?;
            let (record, moved) = (record.to_words(), moved.clone());
            waiting.push(WaitingState {
                place: frame.place,
                frame: frame.frame,
                record,
                most_leaving: frame.most_leaving,
                ages: moved.ages,
                left: moved.left.map(|left| left.keys.len()),
                brought: moved.places.map(|(keys, placed)| keys.iter().map(|k| k.pack()).zip(placed).collect()),
            });
        }
        let swapped = self.swapped.as_ref();
        let surfels = self.surfels.as_mut().map(Surfels::state).transpose()?;
        Ok(MapperState {
            surfels,
            capacity: self.map.capacity(),
            demand: self.demand,
            empty: self.empty,
            beginning: self.beginning,
            frames: self.frames,
            limit: self.limit,
            clock: self.clock,
            leaving: self.leaving,
            rebuild: self.rebuild,
            ages: swapped.map(|s| s.ages.clone()).unwrap_or_default(),
            near: swapped.map_or(0, |s| s.near),
            arriving: swapped.map(|s| s.arriving.iter().copied().collect()).unwrap_or_default(),
            waiting,
        })
    }

    /// The blocks wherever they lie; `None` where all of them lie on the device.
    pub(crate) fn live(&mut self) -> Result<Option<LiveMap<'_>>, Error> {
        self.read_moved()?;
        let live = self.live_map()?;
        Ok((!live.is_on_device()).then_some(live))
    }

    /// The blocks wherever they lie, once [`Mapper::read_moved`] has read what is on its way.
    pub(crate) fn live_map(&self) -> Result<LiveMap<'_>, Error> {
        let store = self.swapped.as_ref().map(|swapped| &swapped.store);
        let on_device = self.map.read_keys()?.into_iter().flatten().map(BlockKey::pack).collect();
        let mut live = LiveMap {
            map: &self.map,
            hash: &self.hash,
            gather: &self.gather,
            store,
            superseded: BTreeSet::new(),
            left: BTreeMap::new(),
            max_weight: largest_weight(&self.settings),
            on_device,
        };
        if let Some(swapped) = &self.swapped {
            live.add_left(&swapped.held);
        }
        self.moved().for_each(|moved| live.add(moved));
        Ok(live)
    }

    /// What has left the device but is not in the store yet, once [`Mapper::state`] has read it.
    pub(crate) fn left(&self) -> impl Iterator<Item = &Left> {
        let held = self.swapped.as_ref().map(|swapped| &swapped.held);
        self.moved().filter_map(|moved| moved.left.as_ref()).chain(held)
    }

    /// Packed keys of stored blocks that are on the device already, once [`Mapper::state`] has read what is on its way: they
    /// leave the store at their frame.
    pub(crate) fn superseded(&self) -> BTreeSet<[u32; 2]> {
        let brought = self.moved().filter_map(|moved| moved.places.as_ref());
        let placed = brought.flat_map(|(keys, placed)| keys.iter().zip(placed).filter(|(_, placed)| **placed));
        placed.map(|(key, _)| key.pack()).collect()
    }

    /// Replaces the map by one that was read back, without its voxels.
    pub(crate) fn restore(&mut self, state: &MapState) -> Result<(), Error> {
        self.map = BlockMap::from_state(&self.device, *self.map.layout(), state)?;
        self.extents = None;
        if self.settings.map.index == MapIndex::Dense {
            self.limit = self.map.capacity();
        }
        Ok(())
    }

    /// Takes over what [`Mapper::state`] gave. `left` are the blocks of all its frames.
    pub(crate) fn set_state(&mut self, state: &mut MapperState, left: Left, block_words: usize) {
        let (mut keys, mut words, mut changed) =
            (left.keys.into_iter(), left.words.into_iter(), left.changed.into_iter());
        let mut left = |count: usize| Left {
            keys: keys.by_ref().take(count).collect(),
            words: words.by_ref().take(count * block_words).collect(),
            changed: changed.by_ref().take(count).collect(),
        };
        let unzip = |brought: Vec<([u32; 2], bool)>| -> (Vec<BlockKey>, Vec<bool>) {
            brought.into_iter().map(|(key, placed)| (BlockKey::unpack(key), placed)).unzip()
        };
        for frame in state.waiting.drain(..) {
            let moved = Moved { ages: frame.ages, left: frame.left.map(&mut left), places: frame.brought.map(unzip) };
            self.waiting.push_back(Waiting {
                place: frame.place,
                frame: frame.frame,
                found: Found::Read(FrameRecord::from_words(frame.record), moved),
                times: Vec::new(),
                most_leaving: frame.most_leaving,
                // By the session that was saved.
                reported: true,
            });
        }
        self.demand = state.demand;
        self.empty = state.empty;
        self.beginning = state.beginning;
        self.frames = state.frames;
        self.limit = self.limit.min(state.limit);
        self.clock = state.clock;
        self.leaving = state.leaving;
        self.rebuild = state.rebuild;
        if let Some(swapped) = &mut self.swapped {
            swapped.ages = std::mem::take(&mut state.ages);
            swapped.ages.resize(AGE_BINS, 0);
            swapped.near = state.near;
            swapped.arriving = state.arriving.iter().copied().collect();
            // What is left over left in no frame that is still to come.
            swapped.held = Left { keys: keys.collect(), words: words.collect(), changed: changed.collect() };
        }
    }

    /// Takes over what an earlier frame's record says. Called once a frame, before anything is allocated.
    pub(crate) fn consume(&mut self) -> Result<Option<Late>, Error> {
        self.frames += 1;
        if let Some(surfels) = &mut self.surfels {
            return Ok(surfels.consume(self.frames)?.map(Late::from));
        }
        let due = self.waiting.front().is_some_and(|w| w.place + RECORD_DELAY <= self.frames);
        let Some(mut waiting) = due.then(|| self.waiting.pop_front()).flatten() else { return Ok(None) };
        let reported = waiting.reported;
        let late = waiting.late(&self.device)?;
        let (_, moved) = waiting.read(&self.device)?;
        let moved = std::mem::take(moved);
        if let Some(swapped) = &mut self.swapped {
            let _placed = swapped.settle(moved)?;
        }
        self.demand = late.record.requested.max(self.demand - self.demand / 8);
        self.make_room(&late.record)?;
        self.decide_what_leaves(&late.record);
        // Walking over the traces of removed blocks makes look-ups slow.
        self.rebuild |= late.record.tombstones > self.map.hash_slots() / 4;
        Ok((!reported).then_some(late))
    }

    /// What is known at the end of a run of frames that have not been reported yet. They are still taken over at their time,
    /// should the run go on.
    pub(crate) fn report_early(&mut self) -> Result<Vec<Late>, Error> {
        if let Some(surfels) = &mut self.surfels {
            return Ok(surfels.report_early()?.into_iter().map(Late::from).collect());
        }
        let unreported = self.waiting.iter_mut().filter(|waiting| !waiting.reported);
        unreported.map(|waiting| waiting.late(&self.device)).collect()
    }

    /// Whether the map holds all the blocks that it may.
    pub(crate) fn is_full(&self, record: &FrameRecord) -> bool {
        self.map.capacity() >= self.limit && record.blocks - record.free_blocks >= self.limit
    }

    /// Blocks that the map should have room for, so that the frames until the next record find some.
    fn needed(&self, record: &FrameRecord) -> u32 {
        let used = record.blocks - record.free_blocks;
        // Requests of the frames since, of this one and of the next, with as much again to spare.
        let spare = self.demand.saturating_mul(2 * (RECORD_DELAY as u32 + 1));
        let arriving = self.swapped.as_ref().map_or(0, |swapped| swapped.near.min(swapped.incoming.room()));
        used.saturating_add(record.pending).saturating_add(spare).saturating_add(arriving)
    }

    /// Has blocks leave where the map cannot grow to what it should have room for.
    fn decide_what_leaves(&mut self, record: &FrameRecord) {
        let needed = self.needed(record);
        let Some(swapped) = &self.swapped else { return };
        if needed <= self.limit {
            return;
        }
        // What left since that record was taken is not in it.
        let on_their_way: u32 = self.waiting.iter().map(|waiting| waiting.most_leaving).sum();
        // A few more, so that not every frame has to.
        let wanted = (needed - self.limit + self.limit / 32).saturating_sub(on_their_way);
        let most = wanted.min(swapped.outgoing.room());
        self.leaving = swapped.least_age(most).map(|age| (most, age));
    }

    /// Grows the pools so that the frames until the next record find room, as far as limits allow.
    fn make_room(&mut self, record: &FrameRecord) -> Result<(), Error> {
        let (needed, capacity) = (self.needed(record), self.map.capacity());
        grow_pools("blocks", needed, capacity, &mut self.limit, |wanted| self.map.grow(wanted))
    }

    /// Fuses a view into a submap, and casts that into `model` for the next frame's tracking. `times` are those of the frame's
    /// earlier stages. Returns whether there is a map: a view without depth cannot begin one.
    pub(crate) fn fuse(
        &mut self,
        frame: u64,
        view: &View,
        at: &Place,
        model: &mut Model,
        mut times: Vec<StageTimes>,
    ) -> Result<bool, Error> {
        if let Some(surfels) = &mut self.surfels {
            return surfels.fuse((self.frames, frame), view, at, &model.image, times);
        }
        let Place { submap, submap_from_camera: world_from_camera, colour_from_depth, .. } = at;
        self.map.look_at(*submap);
        let camera = self.calibration.depth;
        let [near_m, far_m] = [self.settings.view.min_depth_m, self.settings.view.max_depth_m];
        let truncation_m = self.settings.map.truncation_m;
        let swapping = self.swaps();
        let margin_m = if swapping { truncation_m.max(self.settings.map.swap_margin_m) } else { truncation_m };
        self.map.lay_grid(&camera, world_from_camera, far_m, margin_m)?;
        if let Some(extents) = &mut self.extents {
            widen(extents, *submap, self.map.grid_box());
        }
        let (near, far) = (f32::max(near_m - truncation_m, 0.0), far_m + truncation_m);
        let viewed = Viewed { camera: &camera, world_from_camera, depth_range_m: [near, far] };
        let dense = self.settings.map.index == MapIndex::Dense;
        if self.empty && dense {
            if view.read_depth(&self.device, 0)?.data().iter().all(|z| *z <= 0.0) {
                return Ok(false);
            }
            self.empty = false;
        } else if self.empty || std::mem::take(&mut self.beginning) {
            // The first frame asks for more blocks than any other. Nothing waits for it yet, so room is made at once.
            let mut recorder = Recorder::new(&self.device);
            self.caster.allocate.record(&mut recorder, &self.map, view, world_from_camera);
            let _untimed = recorder.submit();
            let record = self.map.read_record()?;
            if record.requested == 0 {
                return Ok(false);
            }
            self.empty = false;
            // Later frames see mostly what this one has seen.
            self.demand = record.requested / 8;
            self.make_room(&record)?;
            if swapping {
                self.make_way(&viewed, record.pending)?;
            }
        }
        let mut recorder = Recorder::timed(&self.device);
        if std::mem::take(&mut self.rebuild) {
            self.hash.rebuild(&mut recorder, &self.map);
        }
        let mut motion = InMotion::default();
        let mut arrivals = None;
        if swapping {
            let leaving = self.leaving.take();
            self.record_leaving(&mut recorder, &mut motion, &viewed, leaving);
            arrivals = self.bring(&viewed)?;
        }
        let arriving = arrivals.as_ref().map(|(_, arrivals)| arrivals);
        if dense {
            self.caster.allocate.fill_grid(&mut recorder, &self.map);
        } else {
            self.caster.allocate.record_with(&mut recorder, &self.map, Some((view, world_from_camera)), arriving);
        }
        if let Some((keys, arrivals)) = arrivals {
            motion.places = self.record_merge(&mut recorder, &keys, &arrivals).map(|places| (keys, places));
        }
        self.caster.visible.record(&mut recorder, &self.map, &camera, world_from_camera, near, far);
        let options = IntegrateOptions {
            max_weight: largest_weight(&self.settings),
            stop_at_max_weight: self.settings.map.stop_at_max_weight,
            colour_band: self.settings.map.colour_band,
            empty_loss: self.settings.map.empty_loss.saturating_mul(best_observation(&self.settings)),
            weighted: self.settings.map.observation_weight == ObservationWeight::Noise,
        };
        let calibration = Calibration { colour_from_depth: *colour_from_depth, ..self.calibration };
        self.integrate.record(&mut recorder, &self.map, view, &calibration, world_from_camera, &options);
        if let Some(changed) = &self.changed {
            changed.record(&mut recorder, &self.map, self.clock_of_changes());
        }
        if let Some((stage, transfer)) = &self.sweep
            && self.frames.is_multiple_of(SWEEP_EVERY)
        {
            stage.record_emptied(&mut recorder, &self.map, transfer);
            self.caster.allocate.fill_grid(&mut recorder, &self.map);
            self.caster.visible.record(&mut recorder, &self.map, &camera, world_from_camera, near, far);
        }
        self.record_model(&mut recorder, model, world_from_camera, [near_m, far]);
        let record = self.map.record_counters(&mut recorder);
        times.push(recorder.submit());
        self.waiting.push_back(Waiting {
            place: self.frames,
            frame,
            most_leaving: motion.most_leaving,
            found: Found::OnDevice(record, Box::new(motion)),
            times,
            reported: false,
        });
        Ok(true)
    }

    /// Whether nothing was fused yet.
    pub(crate) fn is_empty(&self) -> bool {
        self.surfels.as_ref().map_or(self.empty, Surfels::is_empty)
    }

    /// Whether blocks may be removed for good.
    pub(crate) fn removes_blocks(&self) -> bool {
        self.sweep.is_some() || (self.swapped.is_some() && self.settings.map.swapping == Swapping::Delete)
    }

    /// The submaps that have blocks, wherever those lie, or surfels. Waits.
    pub(crate) fn submaps(&mut self) -> Result<BTreeSet<u16>, Error> {
        if let Some(surfels) = &self.surfels {
            return surfels.submaps();
        }
        self.read_moved()?;
        Ok(self.keys()?.map(|key| key.submap).collect())
    }

    /// The keys of all blocks, wherever those lie, once [`Mapper::read_moved`] has read what is on its way; some of them twice.
    fn keys(&self) -> Result<impl Iterator<Item = BlockKey>, Error> {
        let on_device = self.map.read_keys()?.into_iter().flatten();
        let stored = self.swapped.iter().flat_map(|swapped| swapped.store.keys());
        let left = self.left().flat_map(|left| left.keys.iter().copied());
        Ok(on_device.chain(stored).chain(left))
    }

    /// Why the host's store cannot keep to its budget, if so.
    pub(crate) fn store_trouble(&self) -> Option<String> {
        Some(self.swapped.as_ref()?.store.trouble()?.to_string())
    }

    /// Whether blocks leave the device and come back: not before there is reason to.
    fn swaps(&self) -> bool {
        self.swapped.as_ref().is_some_and(|swapped| !swapped.store.is_empty() || self.map.capacity() > self.limit / 2)
    }

    /// Records which blocks a view reaches, and the leaving of so many others from an age on.
    fn record_leaving(
        &mut self,
        recorder: &mut Recorder,
        motion: &mut InMotion,
        viewed: &Viewed<'_>,
        leaving: Option<(u32, u32)>,
    ) {
        let Some(swapped) = &self.swapped else { return };
        self.clock += 1;
        let frame = self.clock;
        let Viewed { camera, world_from_camera, depth_range_m } = *viewed;
        let margin_m = self.settings.map.swap_margin_m;
        let (stage, map, outgoing) = (&swapped.stage, &self.map, &swapped.outgoing);
        let ages = stage.record_ages(recorder, map, camera, world_from_camera, depth_range_m, margin_m, frame);
        motion.ages = Some(ages);
        let Some((most, age)) = leaving else { return };
        motion.most_leaving = most;
        if self.settings.map.swapping == Swapping::Delete {
            stage.record_deletion(recorder, map, outgoing, frame, age, most);
        } else {
            motion.leaving = Some(stage.record_leaving(recorder, map, outgoing, frame, age, most));
        }
    }

    /// Uploads stored blocks that lie near a view.
    fn bring(&mut self, viewed: &Viewed<'_>) -> Result<Option<(Vec<BlockKey>, Arrivals)>, Error> {
        let Some(swapped) = &mut self.swapped else { return Ok(None) };
        let keys = swapped.choose(&self.map, viewed, u32::MAX);
        if keys.is_empty() {
            return Ok(None);
        }
        let arrivals = swapped.bring(&keys)?;
        Ok(Some((keys, arrivals)))
    }

    fn record_merge(&self, recorder: &mut Recorder, keys: &[BlockKey], arrivals: &Arrivals) -> Option<PlacesReader> {
        let swapped = self.swapped.as_ref()?;
        let places = swapped.stage.record_merge(recorder, &self.map, arrivals, largest_weight(&self.settings));
        if let Some(changed) = &self.changed {
            let (changes, now) = (swapped.changes_of(keys), self.clock_of_changes());
            changed.record_arrivals(recorder, &self.map, arrivals, &changes, now);
        }
        Some(places)
    }

    /// The number that blocks remember of this frame: its place among those that came, from 1.
    fn clock_of_changes(&self) -> u32 {
        u32::try_from(self.frames).unwrap_or(u32::MAX)
    }

    /// Frames that have come so far.
    pub(crate) fn frames(&self) -> u64 {
        self.frames
    }

    /// Reads what frames have set in motion and was not taken over yet; that still happens at its frame.
    pub(crate) fn read_moved(&mut self) -> Result<(), Error> {
        for waiting in &mut self.waiting {
            let _read = waiting.read(&self.device)?;
        }
        Ok(())
    }

    /// What [`Mapper::read_moved`] has read, in the order of the frames.
    pub(crate) fn moved(&self) -> impl Iterator<Item = &Moved> {
        self.waiting.iter().filter_map(|frame| match &frame.found {
            Found::Read(_, moved) => Some(moved),
            Found::OnDevice(..) => None,
        })
    }

    /// Takes over what frames have set in motion before it is due. Waits.
    fn settle_all(&mut self) -> Result<(), Error> {
        for waiting in &mut self.waiting {
            let (_, moved) = waiting.read(&self.device)?;
            let moved = std::mem::take(moved);
            if let Some(swapped) = &mut self.swapped {
                let _placed = swapped.settle(moved)?;
            }
        }
        Ok(())
    }

    /// Has blocks out of view leave at once, until so many new ones find room or none can leave. Waits; for the first frame of a
    /// submap, which asks for more than what leaves by and by makes room for.
    fn make_way(&mut self, viewed: &Viewed<'_>, wanted: u32) -> Result<(), Error> {
        self.settle_all()?;
        // All views since the last frame count as one: what was kept for them stays.
        let clock = self.clock;
        loop {
            let record = self.map.read_record()?;
            let used = record.blocks - record.free_blocks;
            let lacking = used.saturating_add(wanted).saturating_sub(self.map.capacity());
            if lacking == 0 {
                return Ok(());
            }
            // How old blocks are as of this view, and then the oldest of them.
            let mut leaving = None;
            for _ in 0..2 {
                let mut motion = InMotion::default();
                let mut recorder = Recorder::new(&self.device);
                self.record_leaving(&mut recorder, &mut motion, viewed, leaving);
                self.clock = clock;
                let _untimed = recorder.submit();
                let moved = motion.read(&self.device)?;
                let Some(swapped) = &mut self.swapped else { return Ok(()) };
                swapped.settle(moved)?;
                let most = lacking.min(swapped.outgoing.room());
                leaving = swapped.least_age(most).map(|age| (most, age));
                if leaving.is_none() {
                    return Ok(());
                }
            }
            let after = self.map.read_record()?;
            if after.blocks - after.free_blocks >= used {
                return Ok(());
            }
        }
    }

    /// Brings all stored blocks that a view reaches to the device, as far as there is room, others leaving for them. Waits;
    /// for views that follow from no frame before.
    fn fetch(&mut self, viewed: &Viewed<'_>) -> Result<(), Error> {
        if self.swapped.as_ref().is_none_or(|swapped| swapped.store.is_empty() && self.waiting.is_empty()) {
            return Ok(());
        }
        self.settle_all()?;
        loop {
            let Some((keys, arrivals)) = self.bring(viewed)? else { return Ok(()) };
            let mut motion = InMotion::default();
            let mut recorder = Recorder::new(&self.device);
            let record = self.map.read_record()?;
            let needed = (record.blocks - record.free_blocks).saturating_add(keys.len() as u32);
            if needed > self.map.capacity() {
                self.make_room(&record)?;
            }
            let lacking = needed.saturating_sub(self.map.capacity());
            self.record_leaving(&mut recorder, &mut motion, viewed, (lacking > 0).then_some((lacking, 1)));
            self.caster.allocate.record_with(&mut recorder, &self.map, None, Some(&arrivals));
            let places = self.record_merge(&mut recorder, &keys, &arrivals);
            motion.places = places.map(|places| (keys, places));
            let _untimed = recorder.submit();
            let Some(swapped) = &mut self.swapped else { return Ok(()) };
            if swapped.settle(motion.read(&self.device)?)? == 0 {
                return Ok(());
            }
        }
    }

    /// Casts a submap as a camera sees it from a pose (its frame), up to a depth. The next frame's fusion is not affected.
    pub(crate) fn cast(
        &mut self,
        image: &RaycastImage,
        submap: u16,
        submap_from_camera: &Se3,
        max_depth_m: f32,
    ) -> Result<(), Error> {
        let extent = self.extent(submap)?;
        self.map.look_at(submap);
        self.map.lay_grid_within(image.camera(), submap_from_camera, max_depth_m, extent)?;
        let mut recorder = Recorder::new(&self.device);
        self.caster.look(&mut recorder, &self.map, image, submap_from_camera, max_depth_m);
        let _untimed = recorder.submit();
        Ok(())
    }

    /// A box that all blocks of a submap on the device lie in. Waits where it is not known.
    fn extent(&mut self, submap: u16) -> Result<[IVec3; 2], Error> {
        let extents = match &mut self.extents {
            Some(extents) => extents,
            None => {
                let mut extents = BTreeMap::new();
                for key in self.map.read_keys()?.into_iter().flatten() {
                    widen(&mut extents, key.submap, [key.position; 2]);
                }
                self.extents.insert(extents)
            }
        };
        Ok(extents.get(&submap).copied().unwrap_or([IVec3::ZERO; 2]))
    }

    /// Lays the grid around a view of a submap that has been cast, for what looks blocks up for its points.
    pub(crate) fn lay_around(
        &mut self,
        recorder: &mut Recorder,
        camera: &Intrinsics,
        submap: u16,
        submap_from_camera: &Se3,
    ) -> Result<(), Error> {
        let max_depth_m = self.settings.view.max_depth_m + self.settings.map.truncation_m;
        self.map.look_at(submap);
        self.map.lay_grid(camera, submap_from_camera, max_depth_m, 0.0)?;
        self.caster.allocate.fill_grid(recorder, &self.map);
        Ok(())
    }

    /// Casts the map for tracking that goes on from a pose that follows from none before. Stored blocks come back for it; waits
    /// for those.
    pub(crate) fn cast_for_tracking(
        &mut self,
        submap: u16,
        model: &mut Model,
        submap_from_camera: &Se3,
    ) -> Result<(), Error> {
        model.full_cast = None;
        self.follow(submap, model, submap_from_camera)
    }

    /// The same for the pose of a frame that is not fused.
    pub(crate) fn follow(&mut self, submap: u16, model: &mut Model, submap_from_camera: &Se3) -> Result<(), Error> {
        if let Some(surfels) = &self.surfels {
            surfels.look(submap, &model.image, submap_from_camera);
            return Ok(());
        }
        let (camera, world_from_camera) = (*model.image.camera(), submap_from_camera);
        let max_depth_m = self.settings.view.max_depth_m + self.settings.map.truncation_m;
        self.map.look_at(submap);
        self.map.lay_grid(&camera, world_from_camera, max_depth_m, self.settings.map.swap_margin_m)?;
        if let Some(extents) = &mut self.extents {
            // Stored blocks may come.
            widen(extents, submap, self.map.grid_box());
        }
        self.fetch(&Viewed { camera: &camera, world_from_camera, depth_range_m: [0.0, max_depth_m] })?;
        self.map.lay_grid(&camera, world_from_camera, max_depth_m, 0.0)?;
        let mut recorder = Recorder::new(&self.device);
        self.caster.find(&mut recorder, &self.map, &camera, world_from_camera, max_depth_m);
        self.record_model(&mut recorder, model, world_from_camera, [NEAR_M, max_depth_m]);
        let _untimed = recorder.submit();
        Ok(())
    }

    /// The same for a submap beside the one that frames are fused into. Waits only where there are blocks in the host's store.
    pub(crate) fn follow_beside(
        &mut self,
        submap: u16,
        model: &mut Model,
        submap_from_camera: &Se3,
    ) -> Result<(), Error> {
        if self.surfels.is_some() || self.swapped.as_ref().is_some_and(|swapped| !swapped.store.is_empty()) {
            return self.follow(submap, model, submap_from_camera);
        }
        let camera = *model.image.camera();
        let max_depth_m = self.settings.view.max_depth_m + self.settings.map.truncation_m;
        self.map.look_at(submap);
        self.map.lay_grid(&camera, submap_from_camera, max_depth_m, 0.0)?;
        let mut recorder = Recorder::new(&self.device);
        if self.swaps() {
            self.keep(&mut recorder, &camera, submap_from_camera, max_depth_m);
        }
        self.caster.find(&mut recorder, &self.map, &camera, submap_from_camera, max_depth_m);
        self.record_model(&mut recorder, model, submap_from_camera, [NEAR_M, max_depth_m]);
        let _untimed = recorder.submit();
        Ok(())
    }

    /// Records that blocks of the submap in view are in use: they do not leave with the next frame.
    fn keep(&self, recorder: &mut Recorder, camera: &Intrinsics, submap_from_camera: &Se3, max_depth_m: f32) {
        let Some(swapped) = &self.swapped else { return };
        let (margin_m, next) = (self.settings.map.swap_margin_m, self.clock + 1);
        let (stage, range) = (&swapped.stage, [0.0, max_depth_m]);
        let _counted_again = stage.record_ages(recorder, &self.map, camera, submap_from_camera, range, margin_m, next);
    }

    /// The next frame is a submap's first. A dense map's submaps each have the box in their own frame; it may find no room, and
    /// then the map is as it was, and no submap begins any more.
    pub(crate) fn begin_submap(&mut self, submap: u16) -> Result<(), Error> {
        if let Some(surfels) = &mut self.surfels {
            surfels.begin_submap();
        } else if self.settings.map.index == MapIndex::Dense {
            let inserted = self.map.insert_empty(&blocks_of_box(submap, &self.settings.map.dense));
            self.may_begin = inserted.is_ok();
            inserted?;
            self.extents = None;
            self.limit = self.map.capacity();
        } else {
            self.beginning = true;
        }
        Ok(())
    }

    /// Whether a further submap may find room.
    pub(crate) fn may_begin_submap(&self) -> bool {
        self.may_begin
    }

    /// Centres of a submap's blocks on the device, in metres, in the order of their indices; of its surfels, where it has those. Waits.
    pub(crate) fn block_centres(&self, submap: u16) -> Result<Vec<DVec3>, Error> {
        if let Some(surfels) = &self.surfels {
            return surfels.centres(submap);
        }
        let keys = self.map.read_keys()?.into_iter().flatten().filter(|key| key.submap == submap);
        Ok(keys.map(|key| self.centre(key)).collect())
    }

    /// Centres of all of a submap's blocks in metres, wherever they lie, in the order of their keys. Waits.
    pub(crate) fn all_block_centres(&mut self, submap: u16) -> Result<Vec<DVec3>, Error> {
        if self.surfels.is_some() {
            return self.block_centres(submap);
        }
        self.read_moved()?;
        let keys: BTreeSet<[u32; 2]> = self.keys()?.filter(|key| key.submap == submap).map(BlockKey::pack).collect();
        Ok(keys.into_iter().map(|key| self.centre(BlockKey::unpack(key))).collect())
    }

    fn centre(&self, key: BlockKey) -> DVec3 {
        let side = f64::from(BLOCK_SIDE);
        (key.position.as_dvec3() * side + 0.5 * (side - 1.0)) * f64::from(self.map.layout().voxel_size_m)
    }

    /// Records what the next frame is tracked against: the map cast anew, or, where the settings ask for it, what the last
    /// frame was tracked against, projected forward.
    fn record_model(
        &mut self,
        recorder: &mut Recorder,
        model: &mut Model,
        world_from_camera: &Se3,
        depth_range_m: [f32; 2],
    ) {
        let settings = &self.settings.tracker.forward_projection;
        let centre = world_from_camera.translation;
        if let (Some(forward), Some((frames, full_at))) = (&self.forward, model.full_cast)
            && frames < settings.max_frames
            && centre.distance(full_at) <= settings.max_move_m
        {
            self.caster.cast_forward(recorder, &self.map, &model.image, forward, world_from_camera, depth_range_m);
            model.full_cast = Some((frames + 1, full_at));
        } else {
            self.caster.cast(recorder, &self.map, &model.image, world_from_camera, depth_range_m);
            model.full_cast = Some((0, centre));
        }
    }
}

/// The keys of all blocks of a dense submap, x fastest.
/// Takes a box into a submap's.
fn widen(extents: &mut BTreeMap<u16, [IVec3; 2]>, submap: u16, [first, last]: [IVec3; 2]) {
    let extent = extents.entry(submap).or_insert([first, last]);
    *extent = [extent[0].min(first), extent[1].max(last)];
}

fn blocks_of_box(submap: u16, dense: &DenseSettings) -> Vec<BlockKey> {
    let ([w, h, d], offset) = dense.blocks();
    let first = IVec3::from_array(offset);
    let at = |x: u32, y: u32, z: u32| first + UVec3::new(x, y, z).as_ivec3();
    (0..d)
        .flat_map(|z| (0..h).flat_map(move |y| (0..w).map(move |x| at(x, y, z))))
        .map(|position| BlockKey { submap, position })
        .collect()
}

/// What the best observation adds to a voxel's weight.
fn best_observation(settings: &Settings) -> u16 {
    match settings.map.observation_weight {
        ObservationWeight::Constant => 1,
        ObservationWeight::Noise => BEST_OBSERVATION,
    }
}

/// A voxel's largest weight: so many of the best observations.
fn largest_weight(settings: &Settings) -> u16 {
    settings.map.max_weight.saturating_mul(best_observation(settings))
}
