//! Maps of earlier runs, as files.

use std::path::{Path, PathBuf};

use glam::DVec3;
use itm_core::block::merge_blocks;
use itm_core::voxel::{BLOCK_SIDE, BlockKey};
use itm_core::{Mesh, Se3, Settings, Trajectory};
use itm_gpu::{Device, MapLayout};
use itm_io::block_store::{BlockStore, Placed, StoreFile};
use itm_io::map_file::{MapHeader, MapReader, MapWriter, SubmapPose, tag};

use crate::Error;
use crate::chunked_mesh::{MeshOptions, mesh_blocks, mesh_in_chunks};
use crate::combined::Combined;
use crate::saving::{LEFT, settings_of};
use crate::source::{AT_A_TIME, BlockSource, submaps};
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
    /// Empty where the file says nothing of submaps.
    poses: Vec<SubmapPose>,
    max_weight: u16,
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
        let poses = reader.submaps()?;
        Ok(Self { path: path.to_path_buf(), header, trajectory, poses, max_weight, store })
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

    /// Where each submap that has blocks lies in the world, in the order of their numbers. Where the file says nothing of
    /// submaps, each submap's frame is the world's.
    ///
    /// # Errors
    /// [`Error::NoSubmapPose`] where it says nothing of one of them.
    pub fn submap_poses(&self) -> Result<Vec<(u16, Se3)>, Error> {
        let pose = |submap| {
            let known = self.poses.iter().find(|pose| pose.submap == submap).map(|pose| pose.world_from_submap);
            let pose = known.or(self.poses.is_empty().then_some(Se3::IDENTITY));
            Ok((submap, pose.ok_or(Error::NoSubmapPose { submap })?))
        };
        self.submaps().into_iter().map(pose).collect()
    }

    /// All submaps as one map, in the world's frame, as blocks of submap 0. A map of one submap in the world's frame comes out
    /// as it is.
    ///
    /// # Errors
    /// As [`Combined::new`].
    pub fn combined(&mut self) -> Result<Combined<'_>, Error> {
        let (poses, max_weight) = (self.submap_poses()?, self.max_weight);
        Combined::new(self, &poses, max_weight)
    }

    /// The surface of the whole map, its submaps [`combined`](Self::combined): see [`mesh_in_chunks`].
    ///
    /// # Errors
    /// As [`Combined::new`] and [`mesh_in_chunks`].
    pub fn mesh(
        &mut self,
        device: &Device,
        options: &MeshOptions,
        progress: &mut dyn FnMut(u64, u64),
    ) -> Result<Mesh, Error> {
        mesh_in_chunks(device, &mut self.combined()?, options, progress)
    }

    /// The surface of one submap, in its own frame: the triangles of just its blocks.
    ///
    /// # Errors
    /// As [`mesh_in_chunks`].
    pub fn mesh_submap(
        &mut self,
        submap: u16,
        device: &Device,
        options: &MeshOptions,
        progress: &mut dyn FnMut(u64, u64),
    ) -> Result<Mesh, Error> {
        let own: Vec<BlockKey> = self.store.keys().filter(|key| key.submap == submap).collect();
        mesh_blocks(device, self, &own, options, progress)
    }

    /// Writes the [`combined`](Self::combined) map as a map file of one submap, with the same header and trajectory, and
    /// returns its number of blocks: those in which something was seen. `progress` is told how many of how many blocks are
    /// done.
    ///
    /// # Errors
    /// As [`Combined::new`], and where the file cannot be written: one of that name is as it was then.
    pub fn fuse_submaps(&mut self, path: &Path, progress: &mut dyn FnMut(u64, u64)) -> Result<u64, Error> {
        let (mut header, trajectory) = (self.header.clone(), self.trajectory.clone());
        let kind = header.voxel_kind;
        let mut combined = self.combined()?;
        let keys = combined.keys();
        header.counts.device_blocks = keys.len() as u64;
        header.counts.host_blocks = 0;
        let mut writer = MapWriter::create(path, &header)?;
        let mut written = 0;
        writer.blocks::<Error>(tag::BLOCKS, |sink| {
            let mut words = vec![0; AT_A_TIME * kind.block_words()];
            for (i, some) in keys.chunks(AT_A_TIME).enumerate() {
                progress((i * AT_A_TIME) as u64, keys.len() as u64);
                let words = &mut words[..some.len() * kind.block_words()];
                combined.read(some, words)?;
                for (key, words) in some.iter().zip(words.chunks_exact(kind.block_words())) {
                    // What was never seen is zero in all planes.
                    if words.iter().any(|word| *word != 0) {
                        sink.block(*key, words)?;
                        written += 1;
                    }
                }
            }
            progress(keys.len() as u64, keys.len() as u64);
            Ok(())
        })?;
        writer.trajectory(&trajectory)?;
        writer.finish()?;
        Ok(written)
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
