//! The surfel map's memory.

use itm_core::surfel::{SURFEL_WORDS, Surfel};
use itm_core::{ColourImage, Intrinsics, Se3, SurfelSettings};
use itm_shaders::associate;

use crate::map::camera_params;
use crate::recorder::{Groups, Pipeline, Recorder};
use crate::scan::{Scan, Total};
use crate::{Device, Error};

const COUNTERS: u64 = 16;
/// Bytes of each of the two parts of a surfel.
const PART_BYTES: u64 = 16;
/// Bytes of a disc as a camera sees it.
const DISC_BYTES: u64 = 32;
/// The largest page, in surfels: more than any adapter's binding holds is no use.
const LARGEST_PAGE_SHIFT: u32 = 26;

/// Words of the counters, as `shared/surfel.wgsl` names them.
pub(crate) mod counter {
    pub(crate) const FREE: u32 = 1;
    pub(crate) const TAKEN: u32 = 2;
    pub(crate) const SEEN: u32 = 3;
    pub(crate) const NEW: u32 = 4;
    /// From this one on all are of one frame.
    pub(crate) const OF_FRAME: std::ops::Range<u32> = NEW..11;
}

/// Surfels in pages, a list of free slots, and what a frame's passes leave for each other. Slot indices stay as the map grows.
#[derive(Clone, Debug)]
pub struct SurfelMap {
    device: Device,
    capacity: u32,
    page_shift: u32,
    pub(crate) counters: wgpu::Buffer,
    /// Centres and confidences; normals, radii, times and colours.
    pub(crate) pages: Vec<[wgpu::Buffer; 2]>,
    pub(crate) free: wgpu::Buffer,
    pub(crate) dead: wgpu::Buffer,
    /// How many surfels of each 32 slots are in view, and which.
    pub(crate) seen: wgpu::Buffer,
    /// Surfels in view: indices; the pixels or cells they compete for, and how they do.
    pub(crate) listed: wgpu::Buffer,
    pub(crate) targets: wgpu::Buffer,
}

/// What a frame left of the surfels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SurfelRecord {
    /// Slots that were ever used.
    pub used: u32,
    /// Free slots among those that are known; more are found now and then.
    pub free: u32,
    /// Surfels in view.
    pub seen: u32,
    /// Surfels that the frame asked for.
    pub new: u32,
    /// Those of them that found no room.
    pub dropped: u32,
    /// Surfels that the frame observed again.
    pub updated: u32,
    /// Surfels merged with others.
    pub merged: u32,
    /// Surfels removed, for they stayed unstable or stood in free space.
    pub removed: u32,
    /// Stable surfels before the frame.
    pub stable: u32,
    /// Surfels that are stable no more, for what they belong to moves or has left.
    pub demoted: u32,
}

impl SurfelRecord {
    /// As numbers.
    pub fn to_words(&self) -> [u32; 10] {
        let Self { used, free, seen, new, dropped, updated, merged, removed, stable, demoted } = *self;
        [used, free, seen, new, dropped, updated, merged, removed, stable, demoted]
    }

    /// The inverse of [`SurfelRecord::to_words`].
    pub fn from_words(words: [u32; 10]) -> Self {
        let [used, free, seen, new, dropped, updated, merged, removed, stable, demoted] = words;
        Self { used, free, seen, new, dropped, updated, merged, removed, stable, demoted }
    }

    fn new(words: &[u32]) -> Self {
        let [used, free, taken, seen, new, dropped, updated, merged, removed, stable, demoted] =
            words[..11].try_into().expect("eleven of sixteen");
        Self { used, free: free - taken, seen, new, dropped, updated, merged, removed, stable, demoted }
    }
}

/// A map of surfels as plain numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SurfelState {
    /// Surfels that there is room for.
    pub capacity: u32,
    /// The device's counters.
    pub counters: Vec<u32>,
    /// Slots that were found free, those that were taken since included.
    pub free: Vec<u32>,
    /// All slots that were ever used, as [`Surfel::to_words`] has them.
    pub slots: Vec<[u32; SURFEL_WORDS]>,
}

/// A frame's record on its way to the host.
#[derive(Debug)]
pub struct SurfelRecordReader {
    staging: wgpu::Buffer,
}

impl SurfelRecordReader {
    /// The record; waits for the frame's commands.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read(self, device: &Device) -> Result<SurfelRecord, Error> {
        Ok(SurfelRecord::new(&device.read_staging::<u32>(&self.staging, COUNTERS * 4)?))
    }
}

impl SurfelMap {
    /// An empty map with room for so many surfels (as many as the device can hold, if that is less).
    ///
    /// # Errors
    /// Where the device has no room for them.
    pub fn new(device: &Device, surfels: u32) -> Result<Self, Error> {
        let capabilities = device.capabilities();
        let in_binding = (capabilities.max_binding_bytes / PART_BYTES).max(1).ilog2();
        let empty = || device.storage("empty", 16);
        let mut map = Self {
            device: device.clone(),
            capacity: 0,
            page_shift: in_binding.min(LARGEST_PAGE_SHIFT),
            counters: device.storage("surfel counters", COUNTERS * 4),
            pages: Vec::new(),
            free: empty(),
            dead: empty(),
            seen: empty(),
            listed: empty(),
            targets: empty(),
        };
        map.grow(surfels)?;
        Ok(map)
    }

    /// Surfels that there is room for.
    pub fn capacity(&self) -> u32 {
        self.capacity
    }

    /// Surfels that the device can hold at most: as many as a list of their indices binds.
    pub fn max_capacity(&self) -> u32 {
        u32::try_from(self.device.capabilities().max_binding_bytes / 4).unwrap_or(u32::MAX).min(1 << 30)
    }

    /// Bytes of device memory that a surfel takes, with what passes leave for each other.
    pub const fn bytes_per_surfel() -> u64 {
        2 * PART_BYTES + 4 * 4
    }

    /// Bytes of device memory that the map takes.
    pub fn device_bytes(&self) -> u64 {
        let rest = [&self.counters, &self.free, &self.dead, &self.seen, &self.listed, &self.targets];
        self.pages.iter().flatten().chain(rest).map(wgpu::Buffer::size).sum()
    }

    /// Surfels of a page at most.
    pub(crate) fn page(&self) -> u32 {
        1 << self.page_shift
    }

    /// Each page with the index of its first surfel.
    pub(crate) fn each_page(&self) -> impl Iterator<Item = (u32, &[wgpu::Buffer; 2])> {
        (0..).step_by(self.page() as usize).zip(&self.pages)
    }

    /// Surfels in view that there is room for: places in the list are numbers of 24 bits (`shared/surfel.wgsl`).
    pub(crate) fn room(&self) -> u32 {
        self.capacity.min(self.page()).min((1 << 24) - 1)
    }

    /// Chunks of 32 slots.
    pub(crate) fn chunks(&self) -> u32 {
        self.capacity / 32
    }

    /// The submaps' poses as the camera sees them, where it looks at all of them.
    pub(crate) fn camera_from_submaps(&self, options: &SurfelOptions<'_>) -> Option<wgpu::Buffer> {
        let Part::Combined(poses) = options.part else { return None };
        let camera_from_world = options.world_from_camera.inverse();
        let matrices: Vec<[[f32; 4]; 4]> =
            poses.iter().map(|pose| (camera_from_world * *pose).to_mat4().to_cols_array_2d()).collect();
        let buffer = self.device.storage("poses of submaps", 64 * matrices.len() as u64);
        self.device.queue.write_buffer(&buffer, 0, bytemuck::cast_slice(&matrices));
        Some(buffer)
    }

    /// Makes room for so many surfels, up to [`SurfelMap::max_capacity`]. What the map holds stays.
    ///
    /// # Errors
    /// Where the device has no memory left; the map is as it was then, and can be used on.
    pub fn grow(&mut self, surfels: u32) -> Result<(), Error> {
        // Whole chunks of slots.
        let surfels = surfels.clamp(32, self.max_capacity()).next_multiple_of(32);
        if surfels <= self.capacity {
            return Ok(());
        }
        // On a copy (of handles): it takes the map's place only once everything has found memory.
        let mut grown = self.clone();
        let mut recorder = Recorder::new(&self.device);
        let scope = self.device.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        grown.make_larger(&mut recorder, surfels);
        if let Some(error) = pollster::block_on(scope.pop()) {
            return Err(Error::OutOfMemory { reason: error.to_string() });
        }
        let _untimed = recorder.submit();
        *self = grown;
        // So that the copies' sources are freed before anything else is made.
        self.device.wait()
    }

    fn make_larger(&mut self, recorder: &mut Recorder, surfels: u32) {
        let device = self.device.clone();
        let mut replace = |buffer: &mut wgpu::Buffer, label: &str, bytes: u64, kept: u64| {
            let grown = device.storage(label, bytes);
            if kept > 0 {
                recorder.copy(buffer, &grown, kept);
            }
            *buffer = grown;
        };
        let (new, old) = (u64::from(surfels), u64::from(self.capacity));
        replace(&mut self.free, "free surfels", new * 4, old * 4);
        replace(&mut self.dead, "dead surfels", new / 32 * 4, 0);
        replace(&mut self.seen, "chunks of surfels in view", new / 32 * 8, 0);
        let page = u64::from(self.page());
        for first in (0..new).step_by(page as usize) {
            let bytes = (new - first).min(page) * PART_BYTES;
            match self.pages.get_mut((first / page) as usize) {
                None => self.pages.push(["surfels", "surfel attributes"].map(|label| device.storage(label, bytes))),
                Some(parts) if parts[0].size() < bytes => {
                    let kept = parts[0].size();
                    parts.iter_mut().for_each(|part| replace(part, "surfels", bytes, kept));
                }
                Some(_) => {}
            }
        }
        self.capacity = surfels;
        let room = u64::from(self.room());
        replace(&mut self.listed, "surfels in view", room * 4, 0);
        replace(&mut self.targets, "surfels' targets", room * 8, 0);
    }

    /// Records the reading of the counters.
    pub fn record_counters(&self, recorder: &mut Recorder) -> SurfelRecordReader {
        let staging = self.device.staging("surfel record", COUNTERS * 4);
        recorder.copy(&self.counters, &staging, COUNTERS * 4);
        SurfelRecordReader { staging }
    }

    /// Reads the counters; waits for all that was submitted.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read_record(&self) -> Result<SurfelRecord, Error> {
        Ok(SurfelRecord::new(&self.device.read::<u32>(&self.counters, 0, COUNTERS * 4)?))
    }

    /// Reads all slots that were ever used back, in their order, the words of [`Surfel::to_words`] each. Waits.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read_words(&self) -> Result<Vec<[u32; SURFEL_WORDS]>, Error> {
        let used = self.read_record()?.used;
        let mut slots = Vec::with_capacity(used as usize);
        for (first, [places, attributes]) in self.each_page() {
            let count = u64::from(used.saturating_sub(first).min(self.page()));
            if count == 0 {
                break;
            }
            let places: Vec<[u32; 4]> = self.device.read(places, 0, count * PART_BYTES)?;
            let attributes: Vec<[u32; 4]> = self.device.read(attributes, 0, count * PART_BYTES)?;
            let whole = |([a, b, c, d], [e, f, g, h]): ([u32; 4], [u32; 4])| [a, b, c, d, e, f, g, h];
            slots.extend(places.into_iter().zip(attributes).map(whole));
        }
        Ok(slots)
    }

    /// Reads all surfels back, in the order of their slots. Waits.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read(&self) -> Result<Vec<Surfel>, Error> {
        Ok(self.read_words()?.into_iter().filter_map(Surfel::from_words).collect())
    }

    /// Reads the counters and the free slots back, from which a map that was read goes on as it was. Waits.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read_state(&self) -> Result<SurfelState, Error> {
        let counters: Vec<u32> = self.device.read(&self.counters, 0, COUNTERS * 4)?;
        let free = match counters[counter::FREE as usize] {
            0 => Vec::new(),
            count => self.device.read(&self.free, 0, u64::from(count) * 4)?,
        };
        Ok(SurfelState { capacity: self.capacity, counters, free, slots: self.read_words()? })
    }

    /// A map as it was read back.
    ///
    /// # Errors
    /// Where the device has no room, and where the numbers do not fit together.
    pub fn write_state(&mut self, state: &SurfelState) -> Result<(), Error> {
        let counted = |word: u32| state.counters.get(word as usize).map(|count| *count as usize);
        let fits = state.counters.len() as u64 == COUNTERS
            && counted(0) == Some(state.slots.len())
            && counted(counter::FREE) == Some(state.free.len())
            && counted(counter::TAKEN) <= counted(counter::FREE)
            && state.slots.len() <= state.capacity as usize
            && state.free.is_sorted_by(|one, next| one < next)
            && state.free.last().is_none_or(|slot| (*slot as usize) < state.slots.len());
        // Those that were not taken since.
        let untaken = || state.free.iter().skip(counted(counter::TAKEN).unwrap_or(0));
        let fits = fits && untaken().all(|slot| f32::from_bits(state.slots[*slot as usize][3]) == 0.0);
        if !fits {
            return Err(Error::State { what: "map of surfels" });
        }
        self.grow(state.capacity)?;
        self.write_words(&state.slots)?;
        self.device.queue.write_buffer(&self.free, 0, bytemuck::cast_slice(&state.free));
        self.device.queue.write_buffer(&self.counters, 0, bytemuck::cast_slice(&state.counters));
        self.device.queue.submit([]);
        self.device.wait()
    }

    /// Replaces all surfels. A slot may be empty.
    ///
    /// # Errors
    /// Where the device cannot hold them, or was lost or ran out of memory.
    pub fn write_words(&mut self, slots: &[[u32; SURFEL_WORDS]]) -> Result<(), Error> {
        let count = u32::try_from(slots.len()).unwrap_or(u32::MAX);
        if count > self.max_capacity() {
            let reason = format!("{} surfels, where at most {} fit", slots.len(), self.max_capacity());
            return Err(Error::OutOfMemory { reason });
        }
        self.grow(count)?;
        for ((_, [places, attributes]), slots) in self.each_page().zip(slots.chunks(self.page() as usize)) {
            let part = |from: usize| -> Vec<u32> { slots.iter().flat_map(|s| s[from..from + 4].to_vec()).collect() };
            self.device.queue.write_buffer(places, 0, bytemuck::cast_slice(&part(0)));
            self.device.queue.write_buffer(attributes, 0, bytemuck::cast_slice(&part(4)));
        }
        let mut counters = [0_u32; COUNTERS as usize];
        counters[0] = count;
        self.device.queue.write_buffer(&self.counters, 0, bytemuck::cast_slice(&counters));
        self.device.queue.submit([]);
        self.device.wait()
    }
}

/// What the pixels of a view keep between the passes over surfels.
#[derive(Debug)]
pub struct SurfelView {
    pub(crate) camera: Intrinsics,
    /// Keys of the best known surfels at each pixel; while surfels are drawn, nearest depths.
    pub(crate) best: wgpu::Buffer,
    pub(crate) chosen: wgpu::Buffer,
    pub(crate) rivals: wgpu::Buffer,
    pub(crate) wanted: wgpu::Buffer,
    /// Pixels whose measurements have no surfel, behind their number.
    pub(crate) open: wgpu::Buffer,
    pub(crate) colours: wgpu::Buffer,
    /// Images are drawn in bands of so many rows, whose cells the buffers hold.
    band_rows: u32,
    /// Of cells, which reach beyond a band: nearest depths of centres, and the keys of the surfels that are drawn.
    pub(crate) front: wgpu::Buffer,
    pub(crate) kept: wgpu::Buffer,
    /// Their discs as the camera sees them, and their confidences and colours.
    pub(crate) discs: wgpu::Buffer,
    pub(crate) looks: wgpu::Buffer,
    /// The cells of large discs, behind their number.
    pub(crate) large: wgpu::Buffer,
    pub(crate) indirect: wgpu::Buffer,
}

impl SurfelView {
    /// Memory for views of a camera.
    pub fn new(device: &Device, camera: Intrinsics) -> Self {
        let pixels = camera.pixels() as u64;
        let words = |label, count: u64| device.storage(label, count * 4);
        let band_rows = rows_of_bands(&camera, device.capabilities().max_binding_bytes);
        let cells = u64::from(cells_of(&Intrinsics { height: band_rows, ..camera }));
        Self {
            camera,
            best: words("best surfels", pixels),
            chosen: words("chosen surfels", pixels),
            rivals: words("rivals", pixels),
            wanted: words("wanted surfels", 2 * pixels.div_ceil(32)),
            open: words("measurements without a surfel", pixels + 1),
            colours: words("measured colours", pixels),
            band_rows,
            front: words("nearest centres", cells),
            kept: words("drawn surfels", cells),
            discs: device.storage("drawn discs", cells * DISC_BYTES),
            looks: words("drawn colours", cells * 2),
            large: words("large discs", cells + 1),
            indirect: words("surfel indirect", 4),
        }
    }

    /// Reads the colours of the surfels that were drawn last back; where there is none, alpha is 0. Waits.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read_colours(&self, device: &Device) -> Result<ColourImage, Error> {
        let values = device.read(&self.colours, 0, u64::from(self.pixels()) * 4)?;
        Ok(ColourImage::new(self.camera.width, self.camera.height, values).expect("as many values as pixels"))
    }

    pub(crate) fn pixels(&self) -> u32 {
        self.camera.pixels() as u32
    }

    /// The bands of rows in which the image is drawn: the first row of each, and its camera.
    pub(crate) fn bands(&self) -> impl Iterator<Item = (u32, Intrinsics)> {
        let Self { camera, band_rows, .. } = *self;
        (0..camera.height).step_by(band_rows as usize).map(move |first| {
            let height = band_rows.min(camera.height - first);
            (first, Intrinsics { height, cy: camera.cy - f64::from(first), ..camera })
        })
    }

    pub(crate) fn chunks(&self) -> u32 {
        self.pixels().div_ceil(32)
    }
}

/// How the surfels of a frame are looked at.
#[derive(Clone, Copy, Debug)]
pub struct SurfelOptions<'a> {
    /// The camera's pose.
    pub world_from_camera: &'a Se3,
    /// The map's settings.
    pub settings: &'a SurfelSettings,
    /// Nearest and farthest depth in metres at which surfels are seen.
    pub depth_range_m: [f32; 2],
    /// The frame's number, from 1, among those that are fused into the part.
    pub frame: u32,
    /// Which surfels.
    pub part: Part<'a>,
}

/// Which surfels of a map are looked at, and in which frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Part<'a> {
    /// All: the map has one frame.
    Whole,
    /// Those of a submap, in whose frame the camera's pose is.
    Submap(u16),
    /// All, as they lie in the world: each submap's pose, `world_from_submap`, by its number. For drawing alone.
    Combined(&'a [Se3]),
}

impl Part<'_> {
    /// The submap that new surfels belong to.
    pub(crate) fn submap(self) -> u16 {
        match self {
            Self::Submap(submap) => submap,
            Self::Whole | Self::Combined(_) => 0,
        }
    }
}

/// Radius in metres of the disc that a camera's pixel sees at a depth of one metre: of the circle around it.
pub(crate) fn pixel_radius_per_m(camera: &Intrinsics) -> f32 {
    let focal = f64::midpoint(camera.fx.abs(), camera.fy.abs());
    (std::f64::consts::FRAC_1_SQRT_2 / focal) as f32
}

/// The radius that a surfel has, at a depth of one metre, which a pixel sees first.
pub(crate) fn radius_per_m(camera: &Intrinsics, settings: &SurfelSettings) -> f32 {
    pixel_radius_per_m(camera) * settings.radius_factor
}

/// Pixels that a disc reaches to each side at most.
pub(crate) const LARGEST_PX: f32 = 12.0;

/// Cells to each side of the image: discs whose centres lie beyond do not reach into it, nor do their cells touch it.
pub(crate) const BORDER: u32 = LARGEST_PX as u32 + 1;

/// Cells of the size of pixels in which surfels that are drawn compete.
pub(crate) fn cells_of(camera: &Intrinsics) -> u32 {
    (camera.width + 2 * BORDER) * (camera.height + 2 * BORDER)
}

/// Rows of the bands in which an image is drawn, so that a binding of so many bytes holds their cells' discs, and keys their numbers (24 bits).
fn rows_of_bands(camera: &Intrinsics, most_bytes: u64) -> u32 {
    let most_cells = (most_bytes / DISC_BYTES).min((1 << 24) - 1);
    let rows = most_cells / u64::from(camera.width + 2 * BORDER);
    (rows.saturating_sub(2 * u64::from(BORDER)) as u32).clamp(1, camera.height.max(1))
}

/// Passes over a list whose length is known to the device alone: workgroups stride over it, or have a part of it each.
pub(crate) const OVER_LIST: Groups<'static> = Groups::Count([512, 1, 1]);

/// The passes that list the surfels in view, in the order of their slots.
#[derive(Debug)]
pub(crate) struct List {
    /// Of a whole map, without and with the removal of what stayed unstable; of a submap, the same; of all submaps.
    visible: [Pipeline; 5],
    scan: Scan,
    list: Pipeline,
}

impl List {
    pub(crate) fn new(device: &Device) -> Self {
        let variant = |features: &[&str]| Pipeline::new(device, &associate::visible::PASS, features, &[]);
        Self {
            visible: [
                variant(&[]),
                variant(&["removing"]),
                variant(&["of_submap"]),
                variant(&["removing", "of_submap"]),
                variant(&["combined"]),
            ],
            scan: Scan::new(device),
            list: Pipeline::plain(device, &associate::list::PASS),
        }
    }

    /// Records the list of the surfels of at least some confidence that the camera of `pixels` sees; without one, of all of them, and
    /// those that stayed unstable and were not seen for long are removed, and of other submaps those that are hardly known. `camera_from_submaps` is what
    /// [`SurfelMap::camera_from_submaps`] gives.
    pub(crate) fn record(
        &self,
        recorder: &mut Recorder,
        map: &SurfelMap,
        pixels: &SurfelView,
        options: &SurfelOptions<'_>,
        least_confidence: Option<f32>,
        camera_from_submaps: Option<&wgpu::Buffer>,
    ) {
        let camera_from_world = options.world_from_camera.inverse().to_mat4().to_cols_array_2d();
        let is_removing = least_confidence.is_none();
        let variant = match options.part {
            Part::Whole => usize::from(is_removing),
            Part::Submap(_) => 2 + usize::from(is_removing),
            Part::Combined(_) => 4,
        };
        let chunks = map.chunks();
        let over_page = Groups::linear(u64::from(map.page() / 32).min(chunks.into()), 64);
        for (first, [places, attributes]) in map.each_page() {
            let bindings = associate::visible::Bindings {
                params: associate::visible::Params {
                    camera: camera_params(&pixels.camera, options.depth_range_m),
                    camera_from_world,
                    first,
                    page: map.page(),
                    chunks,
                    margin: LARGEST_PX,
                    least_confidence: least_confidence.unwrap_or(0.0),
                    stable: options.settings.stable,
                    frame: options.frame,
                    forget_after: options.settings.forget_after,
                    submap: options.part.submap().into(),
                    kept_elsewhere: options.settings.track_from,
                    unused: [0; 2],
                },
                counters: &map.counters,
                places,
                attributes: (variant > 0).then_some(attributes),
                seen: &map.seen,
                camera_from_submaps,
            };
            recorder.dispatch(&self.visible[variant], &bindings, over_page);
        }
        let (counters, indirect) = (&map.counters, &pixels.indirect);
        let total = Total { counters, slot: counter::SEEN, indirect, indirect_slot: 0, per_group: 64 };
        self.scan.record(recorder, &map.seen, chunks, &total);
        let slots = map.capacity();
        let bindings = associate::list::Bindings {
            params: associate::list::Params { slots, room: map.room(), unused: [0; 2] },
            seen: &map.seen,
            listed: &map.listed,
        };
        recorder.dispatch(&self.list, &bindings, Groups::linear(chunks.into(), 64));
    }
}
