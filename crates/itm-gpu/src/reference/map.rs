//! A voxel block map in ordinary memory.

use std::collections::HashMap;

use glam::{DVec3, IVec3};
use itm_core::voxel::{
    BLOCK_SIDE, BLOCK_VOXELS, ColourVoxel, DistanceKind, DistanceVoxel, FloatVoxel, VoxelKind, index_in_block,
};

/// The voxels of one block, indexed as [`index_in_block`] says.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    /// Distances and their weights.
    pub distances: [DistanceVoxel; BLOCK_VOXELS],
    /// Colours and their weights.
    pub colours: [ColourVoxel; BLOCK_VOXELS],
    /// Confidences.
    pub confidences: [f32; BLOCK_VOXELS],
}

impl Default for Block {
    /// A block of space never seen.
    fn default() -> Self {
        Self {
            distances: [DistanceVoxel::default(); BLOCK_VOXELS],
            colours: [ColourVoxel::default(); BLOCK_VOXELS],
            confidences: [0.0; BLOCK_VOXELS],
        }
    }
}

impl Block {
    /// The voxels as a map of a kind keeps them, plane by plane (see [`VoxelKind::block_words`]).
    pub fn to_words(&self, kind: VoxelKind) -> Vec<u32> {
        let mut words: Vec<u32> = match kind.distance {
            DistanceKind::I16 => self.distances.iter().map(|v| v.0).collect(),
            DistanceKind::F32 => {
                let floats = self.distances.map(|v| FloatVoxel::new(v.distance(), v.weight()));
                bytemuck::cast_slice(&floats).to_vec()
            }
        };
        if kind.colour {
            words.extend(self.colours.iter().map(|v| v.0));
        }
        if kind.confidence {
            words.extend(self.confidences.map(f32::to_bits));
        }
        words
    }

    /// The inverse of [`Block::to_words`]; floats are rounded to fixed-point numbers.
    pub fn from_words(kind: VoxelKind, words: &[u32]) -> Self {
        let mut block = Self::default();
        let (distances, rest) = words.split_at(kind.distance_words() * BLOCK_VOXELS);
        match kind.distance {
            DistanceKind::I16 => block.distances.copy_from_slice(bytemuck::cast_slice(distances)),
            DistanceKind::F32 => {
                for (to, from) in block.distances.iter_mut().zip(bytemuck::cast_slice::<u32, FloatVoxel>(distances)) {
                    *to = DistanceVoxel::new(from.distance(), from.weight());
                }
            }
        }
        if kind.colour {
            block.colours.copy_from_slice(bytemuck::cast_slice(&rest[..BLOCK_VOXELS]));
        }
        if kind.confidence {
            block.confidences.copy_from_slice(bytemuck::cast_slice(&rest[rest.len() - BLOCK_VOXELS..]));
        }
        block
    }
}

/// A map of voxel blocks (Nießner et al. 2013, section 4), with an ordinary hash map in place of a hash.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    /// Edge of a voxel in metres.
    pub voxel_size_m: f32,
    /// Truncation band in metres.
    pub truncation_m: f32,
    /// Blocks by their corner, in blocks.
    pub blocks: HashMap<IVec3, Block>,
}

impl Map {
    /// An empty map.
    pub fn new(voxel_size_m: f32, truncation_m: f32) -> Self {
        Self { voxel_size_m, truncation_m, blocks: HashMap::new() }
    }

    /// Edge of a block in metres.
    pub fn block_size_m(&self) -> f64 {
        f64::from(self.voxel_size_m) * f64::from(BLOCK_SIDE)
    }

    /// The positions of all blocks, in the order of the grid's cells: x fastest, then y, then z.
    pub fn positions(&self) -> Vec<IVec3> {
        let mut positions: Vec<_> = self.blocks.keys().copied().collect();
        sort_by_cell(&mut positions);
        positions
    }

    /// A voxel's distance by its place in the whole map; space never seen where there is no block.
    pub fn distance(&self, voxel: IVec3) -> DistanceVoxel {
        self.find(voxel).map(|(block, at)| block.distances[at]).unwrap_or_default()
    }

    /// A voxel's colour by its place in the whole map; no colour where there is no block.
    pub fn colour(&self, voxel: IVec3) -> ColourVoxel {
        self.find(voxel).map(|(block, at)| block.colours[at]).unwrap_or_default()
    }

    fn find(&self, voxel: IVec3) -> Option<(&Block, usize)> {
        let block = self.blocks.get(&block_of(voxel))?;
        Some((block, index_in_block(voxel.rem_euclid(IVec3::splat(BLOCK_SIDE)))))
    }

    /// Trilinear interpolation at a position in voxels: the distance in units of the truncation band, and the smallest
    /// weight of the eight voxels around.
    pub fn interpolate(&self, position: DVec3) -> (f64, u16) {
        let base = position.floor();
        let f = position - base;
        let mut distance = 0.0;
        let mut weight = u16::MAX;
        for corner in corners() {
            let voxel = self.distance(base.as_ivec3() + corner);
            let share = |f: f64, c: i32| if c == 1 { f } else { 1.0 - f };
            distance +=
                share(f.x, corner.x) * share(f.y, corner.y) * share(f.z, corner.z) * f64::from(voxel.distance());
            weight = weight.min(voxel.weight());
        }
        (distance, weight)
    }
}

/// The block that a voxel belongs to.
pub(crate) fn block_of(voxel: IVec3) -> IVec3 {
    voxel.div_euclid(IVec3::splat(BLOCK_SIDE))
}

/// The eight corners of the unit cube, x fastest.
pub(crate) fn corners() -> impl Iterator<Item = IVec3> {
    (0..8).map(|c| IVec3::new(c & 1, (c >> 1) & 1, c >> 2))
}

/// Sorts positions in the order of the grid's cells: x fastest, then y, then z.
pub(crate) fn sort_by_cell(positions: &mut [IVec3]) {
    positions.sort_unstable_by_key(|p| (p.z, p.y, p.x));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interpolation_meets_the_voxels_and_crosses_blocks_without_a_step() {
        let mut map = Map::new(0.01, 0.04);
        // A distance that rises linearly along x, over two blocks either side of the origin.
        for block in [IVec3::NEG_X, IVec3::ZERO] {
            let mut voxels = Block::default();
            for (i, voxel) in voxels.distances.iter_mut().enumerate() {
                let x = block.x * BLOCK_SIDE + (i as i32 & 7);
                *voxel = DistanceVoxel::new(x as f32 * 0.1, 3);
            }
            map.blocks.insert(block, voxels);
        }
        for x in [-7.5, -1.0, -0.25, 0.0, 3.7] {
            let (distance, weight) = map.interpolate(DVec3::new(x, 2.3, 4.1));
            // Half a step of the fixed-point numbers.
            assert!((distance - 0.1 * x).abs() <= 0.5 / 32767.5 + 1e-6, "{distance} at {x}");
            assert_eq!(weight, 3);
        }
        assert_eq!(map.interpolate(DVec3::new(7.5, 2.0, 2.0)).1, 0, "the eighth voxel lies in no block");
        assert_eq!(map.interpolate(DVec3::splat(100.0)), (1.0, 0));
    }
}
