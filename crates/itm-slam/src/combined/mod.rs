//! The global map: many submaps as one.

mod placement;
mod resample;

use std::collections::{BTreeSet, HashMap, HashSet};

use glam::IVec3;
use itm_core::Se3;
use itm_core::voxel::BlockKey;
use itm_gpu::MapLayout;
use rayon::prelude::*;

use self::placement::{Placement, positions};
use self::resample::{Surroundings, combine};
use crate::Error;
use crate::source::{BlockSource, submaps};

/// Blocks of submaps that are kept, because the next blocks of the world will need them too; or as many as one block needs.
const CACHED_BLOCKS: usize = 4096;
/// World blocks that are made at a time.
const AT_A_TIME: usize = 512;

/// The combined map of all submaps: their signed distances' mean by weight, at each voxel of the world's lattice,
///
/// `F(X) = Σ w_i(P_i X) F_i(P_i X) / Σ w_i(P_i X)`, with `P_i` the pose `submap_from_world` of submap `i`
///
/// (Kähler et al. 2016, *Real-time Large-scale Dense 3D Reconstruction with Loop Closure*; Prisacariu et al. 2017, section on
/// globally consistent reconstruction). Colours are the mean by their own weights; weights and confidences add up, to a
/// largest weight. It is a [`BlockSource`] of blocks of submap 0, each made when it is read, so that whatever meshes, shows or
/// exports a map does so with the combined one, wherever the submaps' blocks lie.
///
/// A submap counts at a voxel where all voxels of its own were seen that trilinear interpolation takes there, as `mesh` and
/// `query` do between voxels. So a submap that is turned loses less than a voxel at the border of what it has seen; filling in
/// from fewer voxels would shift surfaces there by up to half a voxel. Colours, which are kept near surfaces only, are the
/// mean of those voxels that have one. Where a submap's voxels lie on the world's lattice and no other has seen the place, its
/// voxels come out to the bit; all of its block where its frame is the world's.
///
/// # Memory
/// About 40 bytes for each block of the submaps, 12 for each world block and submap that reaches it, and 4096 blocks of
/// submaps that are kept, half as many on their way (or, where more submaps meet in one world block than those hold, the up
/// to 27 of each).
pub struct Combined<'a> {
    source: &'a mut dyn BlockSource,
    assembly: Assembly,
}

/// What blocks of the world are made of: which submaps they are reached by, and the submaps' blocks that were read last.
#[derive(Debug)]
struct Assembly {
    layout: MapLayout,
    max_weight: u16,
    /// The submaps that have blocks, by their numbers.
    placements: Vec<Placement>,
    /// The submaps' blocks.
    there: HashSet<[u32; 2]>,
    /// Positions of the world's blocks and which of `placements` reach them, in order.
    reached: Vec<([i16; 3], u16)>,
    cache: HashMap<[u32; 2], Box<[u32]>>,
}

impl<'a> Combined<'a> {
    /// Combines the submaps of a source by their poses, `world_from_submap`. Those without blocks take no part. Weights add up
    /// to `max_weight`, as in fusion. The source has to stay unchanged.
    ///
    /// # Errors
    /// [`Error::NoSubmapPose`], [`Error::SubmapPose`], [`Error::TwoSubmapPoses`], or [`Error::SubmapOutOfReach`] where blocks
    /// would lie further from the world's origin than can be numbered.
    pub fn new(source: &'a mut dyn BlockSource, poses: &[(u16, Se3)], max_weight: u16) -> Result<Self, Error> {
        let layout = source.layout();
        let keys = source.keys();
        let mut known = HashMap::new();
        for (submap, pose) in poses {
            let pose = Se3::try_from_quaternion(pose.rotation, pose.translation)
                .map_err(|reason| Error::SubmapPose { submap: *submap, reason })?;
            if known.insert(*submap, pose).is_some() {
                return Err(Error::TwoSubmapPoses { submap: *submap });
            }
        }
        let place = |submap: u16| {
            let pose = known.get(&submap).ok_or(Error::NoSubmapPose { submap })?;
            Ok(Placement::new(submap, pose, layout.voxel_size_m.into()))
        };
        let placements: Vec<Placement> = submaps(&keys).into_iter().map(place).collect::<Result<_, Error>>()?;
        let there: HashSet<[u32; 2]> = keys.iter().map(|key| key.pack()).collect();
        let mut reached = Vec::new();
        for (index, placement) in placements.iter().enumerate() {
            let own = keys.iter().filter(|key| key.submap == placement.submap);
            let blocks = world_blocks(placement, own, &there)?;
            // There are no more submaps than 16 bits number.
            reached.extend(blocks.into_iter().map(|position| (position, index as u16)));
        }
        reached.par_sort_unstable();
        let (max_weight, cache) = (max_weight.max(1), HashMap::new());
        Ok(Self { source, assembly: Assembly { layout, max_weight, placements, there, reached, cache } })
    }
}

impl std::fmt::Debug for Combined<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        // A source has nothing to show.
        f.debug_struct("Combined").field("assembly", &self.assembly).finish_non_exhaustive()
    }
}

impl Assembly {
    /// The submaps that reach a block of the world.
    fn submaps_at(&self, position: IVec3) -> impl Iterator<Item = &Placement> {
        let position = narrow(position);
        let first = self.reached.partition_point(|(other, _)| *other < position);
        let here = self.reached[first..].iter().take_while(move |(other, _)| *other == position);
        here.map(|(_, index)| &self.placements[usize::from(*index)])
    }

    /// The blocks of submaps that some block of the world is made of.
    fn needed(&self, position: IVec3) -> impl Iterator<Item = [u32; 2]> {
        let of_submap = move |placement: &Placement| {
            let ([first, last], submap) = (placement.blocks_for(position), placement.submap);
            positions(first, last).map(move |position| BlockKey { submap, position }.pack())
        };
        self.submaps_at(position).flat_map(of_submap).filter(|key| self.there.contains(key))
    }

    /// Reads blocks of submaps into the cache, where they are not there.
    fn fetch(&mut self, source: &mut dyn BlockSource, needed: &BTreeSet<[u32; 2]>) -> Result<(), Error> {
        let missing: Vec<BlockKey> =
            needed.iter().filter(|key| !self.cache.contains_key(*key)).copied().map(BlockKey::unpack).collect();
        if self.cache.len() + missing.len() > CACHED_BLOCKS {
            self.cache.retain(|key, _| needed.contains(key));
        }
        let block_words = self.layout.kind.block_words();
        let mut words = vec![0; missing.len() * block_words];
        source.read(&missing, &mut words)?;
        let blocks = missing.iter().zip(words.chunks_exact(block_words));
        self.cache.extend(blocks.map(|(key, words)| (key.pack(), words.into())));
        Ok(())
    }

    /// Makes a block of the world from blocks in the cache.
    fn make(&self, position: IVec3, block: &mut [u32]) {
        let words = |submap, position| self.cache.get(&BlockKey { submap, position }.pack()).map(|words| &words[..]);
        let here: Vec<&Placement> = self.submaps_at(position).collect();
        if let [only] = here[..]
            && only.is_world
            && let Some(words) = words(only.submap, position)
        {
            block.copy_from_slice(words);
            return;
        }
        let surroundings: Vec<Surroundings<'_>> = here
            .into_iter()
            .map(|placement| Surroundings::new(placement, position, |block| words(placement.submap, block)))
            .collect();
        combine(self.layout.kind, position, &surroundings, self.max_weight, block);
    }
}

impl BlockSource for Combined<'_> {
    fn layout(&self) -> MapLayout {
        self.assembly.layout
    }

    /// By position. A few may come out with no voxel seen.
    fn keys(&self) -> Vec<BlockKey> {
        let blocks = self.assembly.reached.chunk_by(|a, b| a.0 == b.0);
        blocks.map(|same| BlockKey { submap: 0, position: same[0].0.map(i32::from).into() }).collect()
    }

    fn read(&mut self, keys: &[BlockKey], words: &mut [u32]) -> Result<(), Error> {
        let assembly = &mut self.assembly;
        let block_words = assembly.layout.kind.block_words();
        let mut start = 0;
        while start < keys.len() {
            let mut needed = BTreeSet::new();
            let mut end = start;
            // The last one may need more than the bound alone.
            while end < keys.len() && end - start < AT_A_TIME && needed.len() < CACHED_BLOCKS / 2 {
                needed.extend(assembly.needed(keys[end].position));
                end += 1;
            }
            assembly.fetch(self.source, &needed)?;
            let blocks = words[start * block_words..end * block_words].par_chunks_exact_mut(block_words);
            let assembly = &*assembly;
            keys[start..end].par_iter().zip(blocks).for_each(|(key, block)| assembly.make(key.position, block));
            start = end;
        }
        Ok(())
    }
}

/// The positions of the world's blocks that some blocks of a submap reach.
fn world_blocks<'k>(
    placement: &Placement,
    keys: impl Iterator<Item = &'k BlockKey>,
    there: &HashSet<[u32; 2]>,
) -> Result<HashSet<[i16; 3]>, Error> {
    let mut blocks = HashSet::new();
    for key in keys {
        let ends = IVec3::AXES.map(|axis| {
            let next = BlockKey { position: key.position + axis, ..*key };
            !there.contains(&next.pack())
        });
        let reached = placement.reached(key.position, ends);
        let reached = reached.ok_or(Error::SubmapOutOfReach { submap: placement.submap })?;
        blocks.extend(reached.map(narrow));
    }
    Ok(blocks)
}

/// A block's position in as few bytes as it has in its key.
fn narrow(position: IVec3) -> [i16; 3] {
    position.to_array().map(|c| c as i16)
}
