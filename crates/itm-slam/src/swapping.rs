//! Which blocks leave the device, and which come back.
//!
//! The map's blocks lie on the device up to its budget. Beyond it, those that no view has reached for the longest time go
//! to the host's store; stored ones near the view come back before it reaches them. The host knows each frame's pose before
//! anything is allocated, so it finds the stored blocks near a view itself, by cells of 8x8x8 blocks; nothing of them
//! takes device memory.
//!
//! A block may be on its way: it left the device, but has not arrived at the store yet. What is integrated at its place
//! meanwhile is a block of its own, which is fused with it wherever the two meet. Nothing is ever overwritten.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use glam::{DVec3, IVec3};
use itm_core::block::merge_blocks;
use itm_core::voxel::{BLOCK_SIDE, BlockKey, VoxelKind};
use itm_core::{Intrinsics, MapSettings, Se3};
use itm_gpu::swap::{AGE_BINS, AgesReader, Arrivals, LeavingReader, Left, PlacesReader, Swap, Transfer, age_of_bin};
use itm_gpu::{BlockMap, Device, HostBlock};
use itm_io::block_store::{BlockStore, StoreFile};

use crate::Error;

/// A view that blocks are swapped for: a camera at a pose, and the depths that it reaches.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Viewed<'a> {
    pub(crate) camera: &'a Intrinsics,
    pub(crate) world_from_camera: &'a Se3,
    pub(crate) depth_range_m: [f32; 2],
}

/// What a frame has set in motion between device and host.
#[derive(Debug, Default)]
pub(crate) struct InMotion {
    pub(crate) ages: Option<AgesReader>,
    pub(crate) leaving: Option<LeavingReader>,
    pub(crate) places: Option<(Vec<BlockKey>, PlacesReader)>,
    /// Blocks that leave at most.
    pub(crate) most_leaving: u32,
}

/// What a frame set in motion, once it has been done.
#[derive(Clone, Debug, Default)]
pub(crate) struct Moved {
    pub(crate) ages: Option<Vec<u32>>,
    pub(crate) left: Option<Left>,
    /// Which of the blocks that were brought found room.
    pub(crate) places: Option<(Vec<BlockKey>, Vec<bool>)>,
}

impl InMotion {
    /// What became of it; waits for the frame.
    pub(crate) fn read(self, device: &Device) -> Result<Moved, Error> {
        let Self { ages, leaving, places, most_leaving: _ } = self;
        let places = match places {
            Some((keys, places)) => Some((keys, places.read(device)?)),
            None => None,
        };
        Ok(Moved {
            ages: ages.map(|ages| ages.read(device)).transpose()?,
            left: leaving.map(|leaving| leaving.read(device)).transpose()?,
            places,
        })
    }
}

/// The host's part of the map.
#[derive(Debug)]
pub(crate) struct Swapped {
    pub(crate) stage: Swap,
    pub(crate) outgoing: Transfer,
    pub(crate) incoming: Transfer,
    pub(crate) store: BlockStore,
    kind: VoxelKind,
    pub(crate) max_weight: u16,
    voxel_size_m: f32,
    margin_m: f32,
    /// Stored blocks by cell.
    cells: Cells,
    /// Stored blocks that were brought to the device, but are not known to have found room there yet.
    pub(crate) arriving: BTreeSet<[u32; 2]>,
    /// Blocks that left the device while an older part of theirs in the store was on its way to it. They come into the store
    /// once that has left it: fused with it there, they would go with it.
    pub(crate) held: Left,
    /// Ages of the blocks outside the view, as last known.
    pub(crate) ages: Vec<u32>,
    /// Stored blocks near the last view.
    pub(crate) near: u32,
    /// Of stored blocks the last frame that changed each, where someone keeps that.
    pub(crate) changed: BTreeMap<[u32; 2], u32>,
}

impl Swapped {
    /// An empty store, whose file can be made.
    pub(crate) fn new(device: &Device, map: &BlockMap, settings: &MapSettings, max_weight: u16) -> Result<Self, Error> {
        let budget = (settings.host_budget_mib * f64::from(1 << 20)) as u64;
        let kind = map.layout().kind;
        let named = |path: &str| (!path.is_empty()).then(|| PathBuf::from(path));
        let file = match named(&settings.host_file) {
            Some(path) => StoreFile::Kept(path),
            None => StoreFile::Temporary(named(&settings.host_folder)),
        };
        file.check()?;
        Ok(Self {
            stage: Swap::new(device),
            outgoing: Transfer::new(device, map, settings.transfer_blocks),
            incoming: Transfer::new(device, map, settings.transfer_blocks),
            store: BlockStore::new(kind.block_words(), budget, file),
            kind,
            max_weight,
            voxel_size_m: settings.voxel_size_m,
            margin_m: settings.swap_margin_m,
            cells: Cells::default(),
            arriving: BTreeSet::new(),
            held: Left::default(),
            ages: vec![0; AGE_BINS],
            near: 0,
            changed: BTreeMap::new(),
        })
    }

    /// When stored blocks were last changed.
    pub(crate) fn changes_of(&self, keys: &[BlockKey]) -> Vec<u32> {
        keys.iter().map(|key| self.changed.get(&key.pack()).copied().unwrap_or(0)).collect()
    }

    /// Notes when a stored block was last changed.
    pub(crate) fn note_change(&mut self, key: BlockKey, frame: u32) {
        if frame > 0 {
            let last = self.changed.entry(key.pack()).or_default();
            *last = frame.max(*last);
        }
    }

    /// Puts a block into the store, fused with what lies there at its place.
    pub(crate) fn put(&mut self, key: BlockKey, words: &[u32]) -> Result<(), Error> {
        let mut stored = vec![0; self.kind.block_words()];
        // Whether it is beyond the budget shows in the store's trouble, which each frame's report tells.
        let _placed = if self.store.get(key, &mut stored)? {
            merge_blocks(self.kind, &mut stored, words, self.max_weight);
            self.store.put(key, &stored)
        } else {
            self.cells.insert(key);
            self.store.put(key, words)
        };
        Ok(())
    }

    /// Takes over what a frame set in motion. Returns how many blocks came back.
    pub(crate) fn settle(&mut self, moved: Moved) -> Result<u32, Error> {
        let mut back = 0;
        let Moved { ages, left, places } = moved;
        if let Some(ages) = ages {
            self.ages = ages;
        }
        if let Some((keys, places)) = places {
            let mut spare = vec![0; self.kind.block_words()];
            for (key, placed) in keys.into_iter().zip(places) {
                self.arriving.remove(&key.pack());
                if placed {
                    back += 1;
                    self.store.take(key, &mut spare)?;
                    self.cells.remove(key);
                    self.changed.remove(&key.pack());
                }
            }
        }
        let held = std::mem::take(&mut self.held);
        for left in std::iter::once(held).chain(left) {
            self.take_in(left)?;
        }
        Ok(back)
    }

    /// Puts blocks that left into the store, or holds them while older parts of theirs are on the way to the device.
    fn take_in(&mut self, left: Left) -> Result<(), Error> {
        let Left { keys, words, changed } = left;
        let changed = changed.into_iter().chain(std::iter::repeat(0));
        for ((key, block), changed) in keys.into_iter().zip(words.chunks(self.kind.block_words())).zip(changed) {
            if self.arriving.contains(&key.pack()) {
                self.held.keys.push(key);
                self.held.words.extend_from_slice(block);
                self.held.changed.push(changed);
            } else {
                self.put(key, block)?;
                self.note_change(key, changed);
            }
        }
        Ok(())
    }

    /// The age from which on blocks leave, so that `wanted` of them go if there are as many; `None` where none can go, or the
    /// store cannot take more.
    pub(crate) fn least_age(&self, wanted: u32) -> Option<u32> {
        if wanted == 0 || self.store.trouble().is_some() {
            return None;
        }
        let mut found = 0;
        let mut youngest = None;
        for bin in (1..AGE_BINS).rev() {
            if self.ages[bin] > 0 {
                found += self.ages[bin];
                youngest = Some(age_of_bin(bin));
                if found >= wanted {
                    break;
                }
            }
        }
        youngest
    }

    /// The stored blocks that are to come back for a view, at most as many as one transfer takes: those in it first, then
    /// those in its margin, each in the order of their keys.
    pub(crate) fn choose(&mut self, map: &BlockMap, view: &Viewed<'_>, most: u32) -> Vec<BlockKey> {
        if self.store.is_empty() {
            self.near = 0;
            return Vec::new();
        }
        let near = self.cells.near(&Cone::new(view), f64::from(self.voxel_size_m), self.margin_m.into());
        let mut keys: Vec<(bool, [u32; 2], BlockKey)> = near
            .into_iter()
            .map(|(key, outside)| (outside, key.pack(), key))
            .filter(|(_, packed, key)| !self.arriving.contains(packed) && map.grid_covers(*key))
            .collect();
        self.near = keys.len() as u32;
        keys.sort_unstable_by_key(|(outside, packed, _)| (*outside, *packed));
        keys.truncate(most.min(self.incoming.room()) as usize);
        keys.into_iter().map(|(.., key)| key).collect()
    }

    /// Uploads stored blocks, which stay in the store until it is known that they found room.
    pub(crate) fn bring(&mut self, keys: &[BlockKey]) -> Result<Arrivals, Error> {
        let length = self.kind.block_words();
        let mut words = vec![0; keys.len() * length];
        for (key, block) in keys.iter().zip(words.chunks_mut(length)) {
            self.store.get(*key, block)?;
            self.arriving.insert(key.pack());
        }
        let blocks: Vec<_> =
            keys.iter().zip(words.chunks(length)).map(|(key, words)| HostBlock { key: *key, words }).collect();
        Ok(self.stage.bring(&self.incoming, &blocks))
    }
}

/// Keys by the cell of 8x8x8 blocks that they lie in.
#[derive(Debug, Default)]
struct Cells {
    cells: BTreeMap<[i32; 4], BTreeSet<[u32; 2]>>,
}

impl Cells {
    fn cell(key: BlockKey) -> [i32; 4] {
        let IVec3 { x, y, z } = key.position >> 3;
        [i32::from(key.submap), x, y, z]
    }

    fn insert(&mut self, key: BlockKey) {
        self.cells.entry(Self::cell(key)).or_default().insert(key.pack());
    }

    fn remove(&mut self, key: BlockKey) {
        let cell = Self::cell(key);
        if let Some(keys) = self.cells.get_mut(&cell) {
            keys.remove(&key.pack());
            if keys.is_empty() {
                self.cells.remove(&cell);
            }
        }
    }

    /// The keys in a cone or within a margin of it (metres), and whether each lies in the margin only.
    fn near(&self, cone: &Cone, voxel_size_m: f64, margin_m: f64) -> Vec<(BlockKey, bool)> {
        let side = f64::from(BLOCK_SIDE);
        // Of the sphere around a cube of so many voxels.
        let radius = |voxels: f64| 0.5 * 3.0_f64.sqrt() * (voxels - 1.0) * voxel_size_m;
        let mut found = Vec::new();
        for ([_, x, y, z], keys) in &self.cells {
            let centre = (IVec3::new(*x, *y, *z).as_dvec3() * 8.0 * side + 4.0 * side - 0.5) * voxel_size_m;
            if !cone.reaches(centre, radius(8.0 * side) + margin_m) {
                continue;
            }
            for key in keys.iter().map(|packed| BlockKey::unpack(*packed)) {
                let centre = (key.position.as_dvec3() * side + 0.5 * side - 0.5) * voxel_size_m;
                if cone.reaches(centre, radius(side) + margin_m) {
                    found.push((key, !cone.reaches(centre, radius(side))));
                }
            }
        }
        found
    }
}

/// What a view reaches.
struct Cone {
    camera_from_world: Se3,
    /// Inward unit normals of the four sides, through the camera's centre (camera frame).
    sides: [DVec3; 4],
    depth_range_m: [f64; 2],
}

impl Cone {
    fn new(view: &Viewed<'_>) -> Self {
        Self {
            camera_from_world: view.world_from_camera.inverse(),
            sides: view.camera.frustum_sides(),
            depth_range_m: view.depth_range_m.map(f64::from),
        }
    }

    /// Whether a sphere (world frame, metres) reaches into it.
    fn reaches(&self, centre: DVec3, radius: f64) -> bool {
        let p = self.camera_from_world.transform_point(centre);
        let [near, far] = self.depth_range_m;
        p.z + radius >= near && p.z - radius <= far && self.sides.iter().all(|side| side.dot(p) >= -radius)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A block leaves while an older part of its is on the way to the device: neither is lost.
    #[test]
    fn what_leaves_while_an_older_part_arrives_is_kept() {
        if std::env::var_os("ITM_SKIP_GPU_TESTS").is_some() {
            return;
        }
        let device = Device::open("auto").expect("GPU tests need an adapter; a software driver will do");
        let settings = MapSettings::default();
        let kind = VoxelKind::default();
        let layout = itm_gpu::MapLayout { voxel_size_m: 0.01, truncation_m: 0.04, kind };
        let map = BlockMap::new(&device, layout, 8).expect("a small map fits");
        let mut swapped =
            Swapped::new(&device, &map, &settings, 100).expect("the system has a folder for temporary files");
        let key = BlockKey { submap: 0, position: IVec3::new(1, 2, 3) };
        let block = |weight: u16| vec![itm_core::voxel::DistanceVoxel::new(0.5, weight).0; kind.block_words()];
        let left = |weight| Left { keys: vec![key], words: block(weight), changed: vec![7] };
        for (placed, expected) in [(true, 3), (false, 8)] {
            swapped.put(key, &block(5)).expect("it fits");
            swapped.arriving.insert(key.pack());
            swapped.settle(Moved { left: Some(left(3)), ..Moved::default() }).expect("it fits");
            let mut found = vec![0; kind.block_words()];
            assert!(swapped.store.get(key, &mut found).expect("it is read") && found == block(5), "held apart");
            let places = Some((vec![key], vec![placed]));
            let back = swapped.settle(Moved { places, ..Moved::default() }).expect("it fits");
            assert_eq!(back, u32::from(placed));
            // Where the older part has come to the device the newer one alone is stored, or else both.
            assert!(swapped.store.take(key, &mut found).expect("it is read"));
            assert_eq!(found, block(expected));
            assert!(swapped.held.keys.is_empty());
            swapped.cells.remove(key);
        }
    }

    #[test]
    fn keys_near_a_view_are_found_by_their_cells() {
        let camera = Intrinsics::new(64, 48, 50.0, 50.0, 31.5, 23.5);
        let pose = Se3::exp([0.1, -0.2, 0.3, 0.2, 0.5, -0.1]);
        let cone = Cone::new(&Viewed { camera: &camera, world_from_camera: &pose, depth_range_m: [0.2, 2.0] });
        let mut cells = Cells::default();
        let keys: Vec<BlockKey> = (0..20 * 20 * 20)
            .map(|i| IVec3::new(i % 20, i / 20 % 20, i / 400) - 10)
            .map(|position| BlockKey { submap: 0, position })
            .collect();
        keys.iter().for_each(|key| cells.insert(*key));
        let (voxel, margin) = (0.05, 0.15);
        let found: BTreeSet<_> = cells.near(&cone, voxel, margin).iter().map(|(key, _)| key.pack()).collect();
        let radius = 3.5 * 3.0_f64.sqrt() * voxel + margin;
        for key in &keys {
            let centre = (key.position.as_dvec3() * 8.0 + 3.5) * voxel;
            assert_eq!(found.contains(&key.pack()), cone.reaches(centre, radius), "{key:?}");
        }
        assert!(!found.is_empty() && found.len() < keys.len());
        keys.iter().for_each(|key| cells.remove(*key));
        assert!(cells.cells.is_empty());
    }
}
