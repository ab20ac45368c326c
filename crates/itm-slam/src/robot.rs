//! What robots ask of a map while it grows: distances along a path, what has changed, and meshes of just that.
//!
//! The map's blocks may lie on the device, in the host's store, or on their way there; what is answered here takes all of them
//! into account, and leaves each where it is.

use std::collections::{BTreeSet, HashMap, HashSet};

use glam::Vec3;
use itm_core::Mesh;
use itm_core::block::merge_blocks;
use itm_core::sample::{Cell, Sample, block_of, distance_in_block};
use itm_core::voxel::BlockKey;
use itm_gpu::hash::Hash;
use itm_gpu::query::Query;
use itm_gpu::swap::{Gather, Left};
use itm_gpu::{BlockMap, Device, MapLayout};

use crate::chunked_mesh::mesh_some;
use crate::mapper::Mapper;
use crate::source::BlockSource;
use crate::views::full_weight;
use crate::{Error, MeshOptions, Slam};

/// Points that are answered at a time on the host, which bounds the blocks in its memory.
const HOST_POINTS_AT_ONCE: usize = 4096;

/// The stages that answer, and the map for parts that are meshed.
#[derive(Debug)]
pub(crate) struct Questions {
    query: Query,
    hash: Hash,
    gather: Gather,
    part: BlockMap,
}

impl Questions {
    fn new(device: &Device, layout: MapLayout) -> Result<Self, Error> {
        Ok(Self {
            query: Query::new(device),
            hash: Hash::new(device),
            gather: Gather::new(device),
            part: BlockMap::new(device, layout, 1)?,
        })
    }
}

/// A session's blocks between two frames, wherever they lie.
struct LiveBlocks<'a> {
    mapper: &'a Mapper,
    hash: &'a Hash,
    gather: &'a Gather,
    max_weight: u16,
    on_device: Vec<BlockKey>,
    /// Blocks in the store that are on the device again, where they have been merged.
    superseded: HashSet<[u32; 2]>,
    /// Blocks on their way to the store: where each of one key lies in what left.
    left: HashMap<[u32; 2], Vec<(&'a Left, usize)>>,
}

impl<'a> LiveBlocks<'a> {
    /// Of a mapper that has read what is on its way ([`Mapper::read_moved`]).
    fn new(slam: &'a Slam, hash: &'a Hash, gather: &'a Gather) -> Result<Self, Error> {
        let (mapper, max_weight) = (&slam.mapper, full_weight(&slam.settings));
        let mut superseded = HashSet::new();
        let mut left: HashMap<[u32; 2], Vec<(&Left, usize)>> = HashMap::new();
        for moved in mapper.moved() {
            if let Some((keys, placed)) = &moved.places {
                superseded.extend(keys.iter().zip(placed).filter(|(_, placed)| **placed).map(|(key, _)| key.pack()));
            }
            if let Some(some) = &moved.left {
                for (index, key) in some.keys.iter().enumerate() {
                    left.entry(key.pack()).or_default().push((some, index));
                }
            }
        }
        let on_device = mapper.map.read_keys()?.into_iter().flatten().collect();
        Ok(Self { mapper, hash, gather, max_weight, on_device, superseded, left })
    }

    /// Whether the host has a part of a block that the device has not.
    fn on_host(&self, key: BlockKey) -> bool {
        self.left.contains_key(&key.pack()) || self.stored(key)
    }

    fn stored(&self, key: BlockKey) -> bool {
        let there = self.mapper.swapped.as_ref().is_some_and(|swapped| swapped.store.contains(key));
        there && !self.superseded.contains(&key.pack())
    }

    /// Whether all blocks lie on the device, and nowhere else.
    fn host_is_empty(&self) -> bool {
        self.left.is_empty() && self.mapper.swapped.as_ref().is_none_or(|swapped| swapped.store.is_empty())
    }
}

impl LiveBlocks<'_> {
    /// Answers the points for which the device lacks a block, or a part of one, that the host has.
    fn answer(&mut self, points: &[Vec3], samples: &mut [Option<Sample>]) -> Result<(), Error> {
        let MapLayout { voxel_size_m, truncation_m, kind } = self.layout();
        let key = |position| BlockKey { submap: 0, position };
        let mut asked = Vec::new();
        for (index, point) in points.iter().enumerate() {
            let cell = Cell::around(*point, voxel_size_m);
            asked.extend(cell.filter(|cell| cell.blocks().any(|b| self.on_host(key(b)))).map(|cell| (index, cell)));
        }
        for some in asked.chunks(HOST_POINTS_AT_ONCE) {
            let needed: BTreeSet<[u32; 2]> =
                some.iter().flat_map(|(_, cell)| cell.blocks()).map(|position| key(position).pack()).collect();
            let keys: Vec<BlockKey> = needed.iter().copied().map(BlockKey::unpack).collect();
            let mut words = vec![0; keys.len() * kind.block_words()];
            self.read(&keys, &mut words)?;
            let blocks: HashMap<[u32; 2], &[u32]> =
                needed.into_iter().zip(words.chunks_exact(kind.block_words())).collect();
            for (index, cell) in some {
                let voxels = cell.voxels().map(|voxel| {
                    let block = blocks.get(&key(block_of(voxel)).pack());
                    block.map_or((1.0, 0), |words| distance_in_block(kind, words, voxel))
                });
                samples[*index] = cell.interpolate(voxels, voxel_size_m, truncation_m);
            }
        }
        Ok(())
    }
}

impl BlockSource for LiveBlocks<'_> {
    fn layout(&self) -> MapLayout {
        *self.mapper.map.layout()
    }

    fn keys(&self) -> Vec<BlockKey> {
        let stored = self.mapper.swapped.iter().flat_map(|swapped| swapped.store.keys());
        let host = stored.map(BlockKey::pack).chain(self.left.keys().copied());
        let all: BTreeSet<[u32; 2]> = host.chain(self.on_device.iter().map(|key| key.pack())).collect();
        all.into_iter().map(BlockKey::unpack).collect()
    }

    fn read(&mut self, keys: &[BlockKey], words: &mut [u32]) -> Result<(), Error> {
        let map = &self.mapper.map;
        let kind = map.layout().kind;
        let length = kind.block_words();
        words.fill(0);
        let places = self.hash.look_up(map, keys)?;
        let found: Vec<(usize, u32)> =
            places.into_iter().enumerate().filter_map(|(i, place)| Some((i, place?))).collect();
        let indices: Vec<u32> = found.iter().map(|(_, index)| *index).collect();
        let mut read = vec![0; indices.len() * length];
        self.gather.read(map, &indices, &mut read)?;
        for ((i, _), block) in found.iter().zip(read.chunks_exact(length)) {
            words[i * length..(i + 1) * length].copy_from_slice(block);
        }
        // A block without weight has nothing to say, so that parts are merged into one of zeros too.
        let mut part = vec![0; length];
        for (key, into) in keys.iter().zip(words.chunks_exact_mut(length)) {
            if self.stored(*key)
                && let Some(swapped) = &self.mapper.swapped
                && swapped.store.get(*key, &mut part)?
            {
                merge_blocks(kind, into, &part, self.max_weight);
            }
            for (left, index) in self.left.get(&key.pack()).into_iter().flatten() {
                let part = &left.words[index * length..(index + 1) * length];
                merge_blocks(kind, into, part, self.max_weight);
            }
        }
        Ok(())
    }
}

impl Slam {
    /// The signed distance of each point (world frame, metres) from the nearest surface, in metres: positive in front of
    /// surfaces, negative behind them. Blocks that have left the device are asked too. Waits.
    ///
    /// `None` where one of the eight voxels around the point was never seen, and where the point is no number or out of the
    /// map's reach. The map keeps blocks around surfaces only: there is no answer in free space that is further from all
    /// surfaces than their blocks reach either, nor behind a surface beyond the truncation band. Distances are truncated: within
    /// the blocks, what is further than `map.truncation_m` from a surface has that value. They were measured along the
    /// cameras' rays, and are therefore rather too large in front of surfaces that were seen from the side only.
    ///
    /// ```no_run
    /// # use itm_slam::{Error, Slam};
    /// # fn follow(slam: &mut Slam) -> Result<(), Error> {
    /// use glam::Vec3;
    ///
    /// let path: Vec<Vec3> = (0..100).map(|i| Vec3::new(0.0, 0.0, 0.02 * i as f32)).collect();
    /// let clear = slam.distances(&path)?.iter().all(|distance| distance.is_some_and(|metres| metres > 0.015));
    /// println!("{}", if clear { "go on" } else { "stop" });
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// Where the device fails or the host's store cannot be read.
    pub fn distances(&mut self, points: &[Vec3]) -> Result<Vec<Option<f32>>, Error> {
        Ok(self.samples(points)?.into_iter().map(|sample| Some(sample?.distance_m)).collect())
    }

    /// The same with gradients: the derivative of the distance with respect to the point, without unit, which points away from
    /// the surface and has a length of about one within the band and zero beyond it. It is the trilinear interpolant's own
    /// derivative, so that it fits the distances exactly, and jumps by what the surface bends where a point passes from one cube
    /// of voxels to the next.
    ///
    /// ```no_run
    /// # use itm_slam::{Error, Slam};
    /// # fn push_away(slam: &mut Slam, points: &mut [glam::Vec3]) -> Result<(), Error> {
    /// let samples = slam.samples(points)?;
    /// for (point, sample) in points.iter_mut().zip(samples) {
    ///     if let Some(sample) = sample {
    ///         *point += (0.015 - sample.distance_m).max(0.0) * sample.gradient;
    ///     }
    /// }
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// As [`Slam::distances`].
    pub fn samples(&mut self, points: &[Vec3]) -> Result<Vec<Option<Sample>>, Error> {
        self.ask(|questions, slam| {
            let mut samples = questions.query.run(&slam.mapper.map, points)?;
            let mut blocks = LiveBlocks::new(slam, &questions.hash, &questions.gather)?;
            if !blocks.host_is_empty() {
                blocks.answer(points, &mut samples)?;
            }
            Ok(samples)
        })
    }

    /// Frames that [`Slam::process`] and [`Slam::place`] have taken in so far, fused or not, those before a session was saved
    /// included. What [`Slam::changed_since`] counts by: a frame's own index is the caller's, and may jump.
    pub fn frames(&self) -> u64 {
        self.mapper.frames()
    }

    /// The blocks that changed after the first so many frames ([`Slam::frames`]), in the order of their packed keys, wherever
    /// they lie now: those that were in the view of a frame that was fused, whether or not one of their voxels became another,
    /// and those that came back to the device and were merged there with what had been fused meanwhile. A change of place alone
    /// is none. Blocks that are gone, as `map.swapping = "delete"` removes them, are not named: they just are not there any
    /// more. Blocks of a map that a session began in ([`Slam::in_map`]) count once a frame changes them. Waits.
    ///
    /// # Errors
    /// Where `map.track_changes` is off, or the device fails.
    pub fn changed_since(&mut self, frames: u64) -> Result<Vec<BlockKey>, Error> {
        if !self.settings.map.track_changes {
            return Err(Error::ChangesNotTracked);
        }
        self.mapper.read_moved()?;
        let since = u32::try_from(frames).unwrap_or(u32::MAX);
        let mut found: BTreeSet<[u32; 2]> = BTreeSet::new();
        found.extend(self.mapper.map.read_changed_since(since)?.into_iter().map(|(key, _)| key.pack()));
        let stored = self.mapper.swapped.iter().flat_map(|swapped| &swapped.changed);
        found.extend(stored.filter(|(_, changed)| **changed > since).map(|(key, _)| *key));
        for left in self.mapper.moved().filter_map(|moved| moved.left.as_ref()) {
            let both = left.keys.iter().zip(&left.changed);
            found.extend(both.filter(|(_, changed)| **changed > since).map(|(key, _)| key.pack()));
        }
        Ok(found.into_iter().map(BlockKey::unpack).collect())
    }

    /// The surface in some blocks as a mesh (world frame, metres): the triangles of just their cells, wherever the blocks and
    /// those around them lie. Keys of blocks that are not there are passed over. Waits.
    ///
    /// A cell reads voxels beyond its own block, so whoever keeps a mesh block by block makes those of
    /// [`crate::with_neighbours`] anew:
    ///
    /// ```no_run
    /// # use itm_slam::{Error, Slam, with_neighbours};
    /// # fn follow(slam: &mut Slam) -> Result<(), Error> {
    /// let before = slam.frames();
    /// // … some frames later:
    /// let changed = with_neighbours(&slam.changed_since(before)?);
    /// let mesh = slam.mesh_of(&changed)?;
    /// println!("{} blocks have {} triangles now", changed.len(), mesh.triangles.len());
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// Where the device fails, the host's store cannot be read, or there are more vertices than 32 bits can number.
    pub fn mesh_of(&mut self, keys: &[BlockKey]) -> Result<Mesh, Error> {
        self.ask(|questions, slam| {
            let mut blocks = LiveBlocks::new(slam, &questions.hash, &questions.gather)?;
            let options = MeshOptions::default();
            mesh_some(&slam.extract, &mut questions.part, &mut blocks, keys, &options, &mut |_, _| ())
        })
    }

    fn ask<T>(&mut self, answer: impl FnOnce(&mut Questions, &Self) -> Result<T, Error>) -> Result<T, Error> {
        self.mapper.read_moved()?;
        let mut questions = match self.questions.take() {
            Some(questions) => questions,
            None => Questions::new(&self.device, *self.mapper.map.layout())?,
        };
        let answer = answer(&mut questions, self);
        self.questions = Some(questions);
        answer
    }
}
