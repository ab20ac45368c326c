//! Maps of earlier runs, as files.

use std::path::{Path, PathBuf};

use glam::DVec3;
use itm_core::block::merge_blocks;
use itm_core::voxel::{BLOCK_SIDE, BlockKey};
use itm_core::{Mesh, Settings, Trajectory};
use itm_gpu::{Device, MapLayout};
use itm_io::block_store::{BlockStore, Placed, StoreFile};
use itm_io::map_file::{MapHeader, MapReader, tag};

use crate::Error;
use crate::chunked_mesh::{MeshOptions, mesh_in_chunks};
use crate::saving::{LEFT, settings_of};
use crate::source::{BlockSource, submaps};
use crate::views::full_weight;

/// The map in a map file, its blocks in the host's memory up to a budget and in a temporary file beyond it.
///
/// ```no_run
/// use itm_slam::{Device, MeshOptions, SavedMap};
///
/// let mut map = SavedMap::open("room.itm".as_ref(), 1 << 30, &mut |_, _| ())?;
/// println!("{} blocks of {} m voxels", map.blocks(), map.header().voxel_size_m);
/// let mesh = map.mesh(&Device::open("auto")?, &MeshOptions::default(), &mut |_, _| ())?;
/// # Ok::<(), itm_slam::Error>(())
/// ```
#[derive(Debug)]
pub struct SavedMap {
    path: PathBuf,
    header: MapHeader,
    trajectory: Trajectory,
    store: BlockStore,
}

impl SavedMap {
    /// Reads a map file. Blocks of one place that were on the device, in the host's store and on the way between them
    /// are merged. `progress` is told how many of how
    /// many bytes of blocks have been read, before compression.
    ///
    /// # Memory
    /// Blocks take `memory_budget_bytes` of the host's memory, and as much of the disk (in the system's folder for temporary
    /// files) as they need beyond that; the index takes about 60 bytes a block.
    ///
    /// # Errors
    /// Where the file cannot be read, is no map, is cut off or damaged: see [`MapReader`]. Where the temporary file cannot be
    /// written, more memory is taken instead, with a warning.
    pub fn open(path: &Path, memory_budget_bytes: u64, progress: &mut dyn FnMut(u64, u64)) -> Result<Self, Error> {
        let mut reader = MapReader::open(path)?;
        let header = reader.header().clone();
        let kind = header.voxel_kind;
        let max_weight = settings_of(&header, path).map_or(u16::MAX, |settings| full_weight(&settings));
        let mut store = BlockStore::new(kind.block_words(), memory_budget_bytes, StoreFile::Temporary(None));
        let of_blocks = [tag::BLOCKS, tag::HOST_BLOCKS, LEFT];
        let sections: Vec<_> = reader.sections().filter(|s| of_blocks.contains(&s.tag)).collect();
        let (mut done, all) = (0, sections.iter().map(|s| s.raw_bytes).sum());
        let mut merged = vec![0; kind.block_words()];
        let mut warned = false;
        for section in &sections {
            reader.blocks::<Error>(section.tag, |key, words| {
                done += 8 + words.len() as u64 * 4;
                // Often enough to be seen moving.
                if done % (1 << 20) < kind.block_bytes() {
                    progress(done, all);
                }
                let Some(key) = key else { return Ok(()) };
                let placed = if store.get(key, &mut merged)? {
                    merge_blocks(kind, &mut merged, words, max_weight);
                    store.put(key, &merged)
                } else {
                    store.put(key, words)
                };
                if placed == Placed::BeyondBudget && !warned {
                    warned = true;
                    let reason = store.trouble().map(ToString::to_string).unwrap_or_default();
                    tracing::warn!(reason, "the map takes more memory than it should");
                }
                Ok(())
            })?;
        }
        progress(all, all);
        let trajectory = if reader.has(tag::TRAJECTORY) { reader.trajectory()? } else { Trajectory::default() };
        Ok(Self { path: path.to_path_buf(), header, trajectory, store })
    }

    /// The file that it was read from.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The file's header.
    pub fn header(&self) -> &MapHeader {
        &self.header
    }

    /// The settings of the run that made it.
    ///
    /// # Errors
    /// Where not all of them are known any more; the map can be used all the same.
    pub fn settings(&self) -> Result<Settings, Error> {
        settings_of(&self.header, &self.path)
    }

    /// The camera's way; empty where the file has none.
    pub fn trajectory(&self) -> &Trajectory {
        &self.trajectory
    }

    /// Number of blocks.
    pub fn blocks(&self) -> usize {
        self.store.len()
    }

    /// The submaps that blocks belong to, in their order.
    pub fn submaps(&self) -> Vec<u16> {
        submaps(&self.keys())
    }

    /// Smallest and largest corner of all blocks, in metres, each submap in its own coordinates; `None` without blocks.
    pub fn bounds(&self) -> Option<[DVec3; 2]> {
        let positions = self.store.keys().map(|key| (key.position, key.position));
        let (first, last) = positions.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
        let block_m = f64::from(self.header.voxel_size_m) * f64::from(BLOCK_SIDE);
        Some([first.as_dvec3() * block_m, (last + 1).as_dvec3() * block_m])
    }

    /// The surface of the whole map: see [`mesh_in_chunks`].
    ///
    /// # Errors
    /// As [`mesh_in_chunks`].
    pub fn mesh(
        &mut self,
        device: &Device,
        options: &MeshOptions,
        progress: &mut dyn FnMut(u64, u64),
    ) -> Result<Mesh, Error> {
        mesh_in_chunks(device, self, options, progress)
    }
}

impl BlockSource for SavedMap {
    fn layout(&self) -> MapLayout {
        let MapHeader { voxel_size_m, truncation_m, voxel_kind: kind, .. } = self.header;
        MapLayout { voxel_size_m, truncation_m, kind }
    }

    fn keys(&self) -> Vec<BlockKey> {
        self.store.keys().collect()
    }

    fn read(&mut self, keys: &[BlockKey], words: &mut [u32]) -> Result<(), Error> {
        for (key, words) in keys.iter().zip(words.chunks_exact_mut(self.header.voxel_kind.block_words())) {
            // One that is not there is as if never seen.
            if !self.store.get(*key, words)? {
                words.fill(0);
            }
        }
        Ok(())
    }
}
