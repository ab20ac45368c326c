//! A map of surfels: when it grows, and which stages a frame takes.

use std::collections::{BTreeSet, VecDeque};

use glam::{DVec3, Vec3};
use itm_core::surfel::{SURFEL_WORDS, Surfel};
use itm_core::{
    Calibration, DepthConversion, DepthImage, Frame, Image, Intrinsics, Mesh, Mode, PointCloud, RelocaliserKind, Se3,
    Settings, Timestamp,
};
use itm_gpu::absorb::Absorb;
use itm_gpu::associate::Associate;
use itm_gpu::segment::Segment;
use itm_gpu::splat::{Drawn, Splat};
use itm_gpu::{
    Device, Part, RaycastImage, Recorder, Segmentation, StageTimes, SurfelMap, SurfelOptions, SurfelRecord,
    SurfelRecordReader, SurfelState, SurfelView, View,
};

use serde::{Deserialize, Serialize};

use crate::Error;
use crate::caster::NEAR_M;
use crate::mapper::{Place, grow_pools};
use crate::slam::{Poses, Slam};
use crate::views::depth_millimetres;

/// A frame's record is consumed at this many frames later, whenever it arrived, so that growth happens at the same frame in
/// every run.
const RECORD_DELAY: u64 = 2;
/// So often, in frames, free slots are looked for.
const FREE_EVERY: u32 = 8;
/// What is tracked against is filled from the discs around within so many of their radii: as far as the corner of the cell beside the next one is from a
/// pixel. Between the discs that are drawn there are holes otherwise, which a fast camera sees more of than of anything. In pictures it would thicken
/// outlines.
const FILL: f32 = 3.0;

/// The map and the stages that fill and show it.
#[derive(Debug)]
pub(crate) struct Surfels {
    device: Device,
    calibration: Calibration,
    pub(crate) settings: Settings,
    pub(crate) map: SurfelMap,
    pixels: SurfelView,
    associate: Associate,
    absorb: Absorb,
    splat: Splat,
    /// Finds what moves, where the settings ask for it.
    segment: Option<(Segment, Segmentation)>,
    waiting: VecDeque<Waiting>,
    /// Surfels that one frame asked for lately; decays.
    demand: u32,
    /// Frames fused so far.
    fused: u32,
    /// Of them those that each submap has, by its number.
    ages: Vec<u32>,
    /// Whether the next frame is the first of a submap, which asks for as many surfels as a map's first.
    beginning: bool,
    /// Surfels that the map may grow to.
    limit: u32,
}

#[derive(Debug)]
struct Waiting {
    /// The frame's place among those that came.
    place: u64,
    /// The frame's own index.
    frame: u64,
    found: Found,
    times: Vec<StageTimes>,
    /// Whether it has been told already what became of the frame.
    reported: bool,
}

/// What a frame left behind on the device: to be read, or read, but not taken over yet.
#[derive(Debug)]
enum Found {
    OnDevice(SurfelRecordReader),
    Read(SurfelRecord),
}

/// A [`Surfels`]' state as it is saved, beside the surfels.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct SurfelsState {
    capacity: u32,
    demand: u32,
    fused: u32,
    ages: Vec<u32>,
    beginning: bool,
    waiting: Vec<WaitingState>,
}

#[derive(Debug, Serialize, Deserialize)]
struct WaitingState {
    place: u64,
    frame: u64,
    record: [u32; 10],
}

/// What became known of a frame some frames later.
pub(crate) struct LateSurfels {
    pub(crate) frame: u64,
    pub(crate) record: SurfelRecord,
    pub(crate) stage_ms: Vec<(&'static str, f64)>,
}

impl Waiting {
    fn read(&mut self, device: &Device) -> Result<SurfelRecord, Error> {
        let record = match std::mem::replace(&mut self.found, Found::Read(SurfelRecord::default())) {
            Found::OnDevice(reader) => reader.read(device)?,
            Found::Read(record) => record,
        };
        self.found = Found::Read(record);
        Ok(record)
    }

    /// What became known of the frame, told once.
    fn late(&mut self, device: &Device) -> Result<LateSurfels, Error> {
        self.reported = true;
        let record = self.read(device)?;
        let mut stage_ms = Vec::new();
        for times in self.times.drain(..) {
            stage_ms.extend(times.read(device)?);
        }
        Ok(LateSurfels { frame: self.frame, record, stage_ms })
    }
}

impl Surfels {
    pub(crate) fn new(device: &Device, calibration: &Calibration, settings: &Settings) -> Result<Self, Error> {
        let own = &settings.surfels;
        let map = SurfelMap::new(device, 1)?;
        let budget_bytes = own.device_budget_mib * f64::from(1 << 20);
        let limit = match (budget_bytes / SurfelMap::bytes_per_surfel() as f64) as u32 {
            0 if budget_bytes == 0.0 => map.max_capacity(),
            limit => limit.clamp(1, map.max_capacity()),
        };
        let mut surfels = Self {
            device: device.clone(),
            calibration: *calibration,
            settings: settings.clone(),
            map,
            pixels: SurfelView::new(device, calibration.depth),
            associate: Associate::new(device),
            absorb: Absorb::new(device),
            splat: Splat::new(device),
            segment: own
                .dynamics
                .enabled
                .then(|| (Segment::new(device), Segmentation::new(device, calibration.depth, &own.dynamics))),
            waiting: VecDeque::new(),
            demand: 0,
            fused: 0,
            ages: Vec::new(),
            beginning: false,
            limit,
        };
        surfels.map.grow(own.initial.min(limit))?;
        Ok(surfels)
    }

    /// Whether nothing was fused yet.
    pub(crate) fn is_empty(&self) -> bool {
        self.fused == 0
    }

    /// Takes over what an earlier frame's record says. Called once a frame, with the frame's place among those that came.
    pub(crate) fn consume(&mut self, place: u64) -> Result<Option<LateSurfels>, Error> {
        let due = self.waiting.front().is_some_and(|waiting| waiting.place + RECORD_DELAY <= place);
        let Some(mut waiting) = due.then(|| self.waiting.pop_front()).flatten() else { return Ok(None) };
        let reported = waiting.reported;
        let late = waiting.late(&self.device)?;
        self.demand = late.record.new.max(self.demand - self.demand / 8);
        // Of the frames since, of this one and of the next, with as much again to spare.
        let spare = self.demand.saturating_mul(2 * (RECORD_DELAY as u32 + 1));
        self.make_room(late.record.used.saturating_sub(late.record.free).saturating_add(spare))?;
        Ok((!reported).then_some(late))
    }

    /// What is known at the end of a run of frames that have not been reported yet. They are still taken over at their time,
    /// should the run go on.
    pub(crate) fn report_early(&mut self) -> Result<Vec<LateSurfels>, Error> {
        let unreported = self.waiting.iter_mut().filter(|waiting| !waiting.reported);
        unreported.map(|waiting| waiting.late(&self.device)).collect()
    }

    /// What the next frames depend on beside the surfels; reads what is on its way.
    pub(crate) fn state(&mut self) -> Result<SurfelsState, Error> {
        let mut waiting = Vec::new();
        for frame in &mut self.waiting {
            let record = frame.read(&self.device)?.to_words();
            waiting.push(WaitingState { place: frame.place, frame: frame.frame, record });
        }
        let Self { demand, fused, beginning, .. } = *self;
        Ok(SurfelsState { capacity: self.map.capacity(), demand, fused, ages: self.ages.clone(), beginning, waiting })
    }

    /// Takes over what [`Surfels::state`] gave, and the surfels themselves.
    pub(crate) fn set_state(&mut self, state: &SurfelsState, surfels: SurfelState) -> Result<(), Error> {
        self.map.write_state(&SurfelState { capacity: state.capacity, ..surfels })?;
        (self.demand, self.fused, self.beginning) = (state.demand, state.fused, state.beginning);
        self.ages.clone_from(&state.ages);
        let waiting = state.waiting.iter().map(|frame| Waiting {
            place: frame.place,
            frame: frame.frame,
            found: Found::Read(SurfelRecord::from_words(frame.record)),
            times: Vec::new(),
            // By the session that was saved.
            reported: true,
        });
        self.waiting = waiting.collect();
        Ok(())
    }

    /// Takes in a map's surfels, for a session that starts in it.
    pub(crate) fn take_in(&mut self, slots: &[[u32; SURFEL_WORDS]]) -> Result<(), Error> {
        self.map.write_words(slots)?;
        // Their times go on.
        for surfel in slots.iter().filter_map(|words| Surfel::from_words(*words)) {
            let submap = usize::from(surfel.submap);
            self.ages.resize(self.ages.len().max(submap + 1), 0);
            self.ages[submap] = self.ages[submap].max(surfel.seen);
        }
        self.fused = self.ages.iter().fold(0, |sum, age| sum.saturating_add(*age));
        Ok(())
    }

    /// Grows the map so that it has room for so many, as far as limits allow.
    fn make_room(&mut self, needed: u32) -> Result<(), Error> {
        let capacity = self.map.capacity();
        grow_pools("surfels", needed, capacity, &mut self.limit, |wanted| self.map.grow(wanted))
    }

    /// The next frame is a submap's first.
    pub(crate) fn begin_submap(&mut self) {
        self.beginning = true;
    }

    /// The submaps that have surfels. Waits.
    pub(crate) fn submaps(&self) -> Result<BTreeSet<u16>, Error> {
        Ok(self.map.read()?.into_iter().map(|surfel| surfel.submap).collect())
    }

    /// Where a submap's surfels lie, in metres, in its frame. Waits.
    pub(crate) fn centres(&self, submap: u16) -> Result<Vec<DVec3>, Error> {
        let surfels = self.map.read()?.into_iter().filter(|surfel| surfel.submap == submap);
        Ok(surfels.map(|surfel| surfel.position.as_dvec3()).collect())
    }

    /// How a submap's surfels are looked at.
    fn options<'a>(&'a self, submap: u16, submap_from_camera: &'a Se3) -> SurfelOptions<'a> {
        let far_m = self.settings.view.max_depth_m * 1.05;
        SurfelOptions {
            settings: &self.settings.surfels,
            depth_range_m: [NEAR_M, far_m],
            frame: self.age(submap),
            world_from_camera: submap_from_camera,
            // A map that is not divided is looked at as a whole, which takes less.
            part: if self.ages.len() > 1 { Part::Submap(submap) } else { Part::Whole },
        }
    }

    /// Frames fused into a submap. They are its surfels' time: while frames are fused elsewhere nothing there grows old.
    fn age(&self, submap: u16) -> u32 {
        self.ages.get(usize::from(submap)).copied().unwrap_or(0)
    }

    /// Which surfels are tracked against: those that are known well enough, and others where there are none of those, as where a fast
    /// camera has just got to.
    fn tracked(&self, submap: u16) -> Drawn {
        let own = &self.settings.surfels;
        Drawn {
            least: 0.0,
            preferred: if self.age(submap) <= own.all_for { 0.0 } else { own.track_from },
            // What was seen in passing, and long ago, may have been noise.
            since: self.age(submap).saturating_sub(own.patience),
            reach: own.reach,
            fill: FILL,
        }
    }

    /// Fuses a view into a submap, and draws what the camera sees of it into `image` for the next frame's tracking; what that holds
    /// until then was seen from the place's model. Returns whether there is a map: a view without depth cannot begin one.
    pub(crate) fn fuse(
        &mut self,
        at: (u64, u64),
        view: &View,
        place: &Place,
        image: &RaycastImage,
        mut times: Vec<StageTimes>,
    ) -> Result<bool, Error> {
        let Place { submap, submap_from_camera, colour_from_depth, submap_from_model } = place;
        if self.fused == 0 || self.beginning {
            let measured = view.read_depth(&self.device, 0)?.data().iter().filter(|z| **z > 0.0).count() as u32;
            if measured == 0 {
                return Ok(false);
            }
            self.beginning = false;
            // Most of them become surfels, and the next frames want some room too.
            self.make_room(self.map.read_record()?.used.saturating_add(measured.saturating_mul(2)))?;
        }
        self.fused += 1;
        self.ages.resize(self.ages.len().max(usize::from(*submap) + 1), 0);
        self.ages[usize::from(*submap)] += 1;
        let mut recorder = Recorder::timed(&self.device);
        let options = self.options(*submap, submap_from_camera);
        let calibration = Calibration { colour_from_depth: *colour_from_depth, ..self.calibration };
        self.associate.record(&mut recorder, &self.map, view, &self.pixels, &calibration, &options);
        if let (Some((segment, cells)), Some(seen_from)) = (&self.segment, submap_from_model) {
            segment.record(&mut recorder, &self.map, view, cells, (image, seen_from), &options);
        }
        self.absorb.record(&mut recorder, &self.map, view, &self.pixels, &options);
        if self.fused.is_multiple_of(FREE_EVERY) {
            self.absorb.record_free(&mut recorder, &self.map, &self.pixels);
        }
        self.splat.record_listed(&mut recorder, &self.map, &self.pixels, image, &options, self.tracked(*submap));
        let found = Found::OnDevice(self.map.record_counters(&mut recorder));
        times.push(recorder.submit());
        let (place, frame) = at;
        self.waiting.push_back(Waiting { place, frame, found, times, reported: false });
        Ok(true)
    }

    /// The colours of what was drawn last for tracking; see [`SurfelView::read_colours`].
    pub(crate) fn drawn(&self) -> &SurfelView {
        &self.pixels
    }

    /// Draws what the camera sees of a submap from a pose, for tracking.
    pub(crate) fn look(&self, submap: u16, image: &RaycastImage, submap_from_camera: &Se3) {
        let mut recorder = Recorder::new(&self.device);
        let (options, tracked) = (self.options(submap, submap_from_camera), self.tracked(submap));
        if image.camera() == &self.calibration.depth {
            self.splat.record(&mut recorder, &self.map, &self.pixels, image, &options, tracked);
        } else {
            let pixels = SurfelView::new(&self.device, *image.camera());
            self.splat.record(&mut recorder, &self.map, &pixels, image, &options, tracked);
        }
        let _untimed = recorder.submit();
    }

    /// What a camera sees of the stable surfels from a pose, up to a depth in metres (of all, while the map is young), with what its
    /// pixels know of colours. `poses` are where the submaps lie in the world, if there are any.
    pub(crate) fn cast(
        &self,
        poses: &[Se3],
        camera: &Intrinsics,
        world_from_camera: &Se3,
        max_depth_m: f32,
    ) -> Result<(RaycastImage, SurfelView), Error> {
        let image = RaycastImage::new(&self.device, *camera)?;
        let pixels = SurfelView::new(&self.device, *camera);
        let mut recorder = Recorder::new(&self.device);
        let seen = self.options(0, world_from_camera);
        let part = if poses.is_empty() { Part::Whole } else { Part::Combined(poses) };
        let options = SurfelOptions { depth_range_m: [NEAR_M, max_depth_m], part, ..seen };
        let least = self.least_shown();
        self.splat.record(
            &mut recorder,
            &self.map,
            &pixels,
            &image,
            &options,
            Drawn { least, preferred: least, since: 0, reach: self.settings.surfels.overlap, fill: 1.0 },
        );
        let _untimed = recorder.submit();
        Ok((image, pixels))
    }

    /// Confidence from which on surfels are shown and exported.
    fn least_shown(&self) -> f32 {
        if self.fused <= self.settings.surfels.all_for { 0.0 } else { self.settings.surfels.stable }
    }

    /// The stable surfels (all, while the map is young). Waits.
    pub(crate) fn stable(&self) -> Result<Vec<Surfel>, Error> {
        let least = self.least_shown();
        Ok(self.map.read()?.into_iter().filter(|surfel| surfel.confidence >= least).collect())
    }
}

/// Bytes of device memory that a surfel takes, with what stages leave for each other.
pub const fn bytes_per_surfel() -> u64 {
    SurfelMap::bytes_per_surfel()
}

/// What a camera sees of a map of surfels.
#[derive(Clone, Debug)]
pub struct SeenSurfels {
    /// A point for each pixel that sees one, row by row, in the world's frame. Colours where any has one; others are black then.
    pub points: PointCloud,
    /// Depth along the optical axis; 0 where there is none, or more than 65.534 m.
    pub depth_millimetres: Image<u16>,
}

impl Default for SeenSurfels {
    fn default() -> Self {
        Self { points: PointCloud::default(), depth_millimetres: Image::filled(0, 0, 0) }
    }
}

/// Views of the map for a mesh: another one each so many metres, or radians, along the trajectory.
const VIEW_EVERY_M: f64 = 0.15;
const VIEW_EVERY_RAD: f64 = 0.2;

impl Slam {
    /// The stable surfels (all, while the map is young), in the world's frame. Waits. None where the map is one of voxels.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn surfels(&self) -> Result<Vec<Surfel>, Error> {
        self.mapper.surfels.as_ref().map_or_else(|| Ok(Vec::new()), |surfels| Ok(self.in_world(surfels.stable()?)))
    }

    /// Where each submap lies in the world, by its number; empty where the map is one.
    pub(crate) fn poses_of_submaps(&self) -> Vec<Se3> {
        self.submaps().iter().map(|submap| submap.world_from_submap).collect()
    }

    /// All surfels, unstable ones too, in the world's frame. Waits. None where the map is one of voxels.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn all_surfels(&self) -> Result<Vec<Surfel>, Error> {
        self.mapper.surfels.as_ref().map_or_else(|| Ok(Vec::new()), |surfels| Ok(self.in_world(surfels.map.read()?)))
    }

    fn in_world(&self, surfels: Vec<Surfel>) -> Vec<Surfel> {
        let poses = self.poses_of_submaps();
        let in_world = |surfel: Surfel| match poses.get(usize::from(surfel.submap)) {
            Some(pose) => Surfel {
                position: pose.transform_point(surfel.position.as_dvec3()).as_vec3(),
                normal: pose.transform_vector(surfel.normal.as_dvec3()).as_vec3(),
                ..surfel
            },
            None => surfel,
        };
        surfels.into_iter().map(in_world).collect()
    }

    /// What a camera sees of the stable surfels from a pose, up to a depth in metres. Waits. Nothing where the map is one of voxels, which
    /// [`MapViews`](crate::MapViews) shows.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn seen_surfels(
        &self,
        camera: &Intrinsics,
        world_from_camera: &Se3,
        max_depth_m: f32,
    ) -> Result<SeenSurfels, Error> {
        let Some(surfels) = &self.mapper.surfels else { return Ok(SeenSurfels::default()) };
        let poses = self.poses_of_submaps();
        let (image, pixels) = surfels.cast(&poses, camera, world_from_camera, max_depth_m)?;
        let (points, normals) = (image.read_points(&self.device)?, image.read_normals(&self.device)?);
        let colours = pixels.read_colours(&self.device)?;
        let coloured = colours.data().iter().any(|colour| colour[3] > 0);
        let mut cloud = PointCloud::default();
        for ((&[x, y, z, known], &[nx, ny, nz, _]), &[r, g, b, _]) in
            points.data().iter().zip(normals.data()).zip(colours.data()).filter(|((point, _), _)| point[3] > 0.0)
        {
            cloud.positions.push(Vec3::new(x, y, z));
            cloud.normals.push(Vec3::new(nx, ny, nz));
            cloud.colours.extend(coloured.then_some([r, g, b]));
            cloud.confidences.push(known - 1.0);
        }
        Ok(SeenSurfels { points: cloud, depth_millimetres: depth_millimetres(&points, world_from_camera) })
    }

    /// A mesh of the surfels: what the camera would see of them along its way, fused into voxels of `map.voxel_size_m`.
    pub(crate) fn mesh_of_surfels(&mut self, progress: &mut dyn FnMut(u32, u32)) -> Result<Mesh, Error> {
        let Some(surfels) = &self.mapper.surfels else { return Ok(Mesh::default()) };
        let mut settings = Settings { mode: Mode::Basic, ..self.settings.clone() };
        settings.relocaliser.kind = RelocaliserKind::Off;
        settings.view.bilateral.passes = 0;
        settings.view.colour = true;
        (settings.map.fuse, settings.map.track_changes) = (true, false);
        let camera = self.calibration.depth;
        let calibration = Calibration::registered(camera, DepthConversion::MILLIMETRES);
        let mut fusion = Slam::new(&self.device, &calibration, &settings, Poses::Given)?;
        let submaps = self.poses_of_submaps();
        let mut views: Vec<Se3> = Vec::new();
        for pose in self.corrected_trajectory().poses() {
            let pose = pose.world_from_camera;
            let far = views.last().is_none_or(|last| {
                let off = last.inverse() * pose;
                off.translation.length() > VIEW_EVERY_M || off.angle() > VIEW_EVERY_RAD
            });
            if far {
                views.push(pose);
            }
        }
        let count = u32::try_from(views.len()).unwrap_or(u32::MAX);
        for (index, pose) in (0..).zip(views) {
            progress(index, count);
            let (image, pixels) = surfels.cast(&submaps, &camera, &pose, self.settings.view.max_depth_m)?;
            let camera_from_world = pose.inverse();
            let depth_at = |[x, y, z, seen]: &[f32; 4]| match *seen {
                0.0 => 0.0,
                _ => camera_from_world.transform_point(DVec3::new((*x).into(), (*y).into(), (*z).into())).z as f32,
            };
            let points = image.read_points(&self.device)?;
            let depth = Image::new(camera.width, camera.height, points.data().iter().map(depth_at).collect());
            let depth = DepthImage::Metres(depth.expect("as many values as pixels"));
            let timestamp = Timestamp(i64::from(index));
            let colour = Some(pixels.read_colours(&self.device)?);
            let mut frame = Frame::new(index.into(), timestamp, depth, colour);
            frame.world_from_camera = Some(pose);
            fusion.process(&frame)?;
        }
        progress(count, count);
        fusion.mesh(&mut |_, _| ())
    }
}
