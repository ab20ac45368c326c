//! Submaps' voxels, interpolated on the world's lattice.

use glam::{DVec3, IVec3};
use itm_core::sample::{Cell, block_of, colour_in_block, confidence_in_block, distance_in_block};
use itm_core::voxel::{
    BLOCK_SIDE, BLOCK_VOXELS, ColourVoxel, DistanceKind, DistanceVoxel, FloatVoxel, VoxelKind, index_in_block,
};

use super::placement::{Placement, positions};

/// The blocks of a submap that a world block's voxels are interpolated from.
pub(super) struct Surroundings<'a> {
    placement: &'a Placement,
    first: IVec3,
    /// Blocks along each axis.
    size: IVec3,
    /// Words of each block, x fastest; `None` where there is no block.
    blocks: Vec<Option<&'a [u32]>>,
}

impl<'a> Surroundings<'a> {
    /// From what `words` says of a block by its position.
    pub(super) fn new(
        placement: &'a Placement,
        world_block: IVec3,
        words: impl Fn(IVec3) -> Option<&'a [u32]>,
    ) -> Self {
        let [first, last] = placement.blocks_for(world_block);
        Self { placement, first, size: last - first + 1, blocks: positions(first, last).map(words).collect() }
    }

    fn block_around(&self, voxel: IVec3) -> Option<&'a [u32]> {
        let at = block_of(voxel) - self.first;
        if at.cmplt(IVec3::ZERO).any() || at.cmpge(self.size).any() {
            return None;
        }
        self.blocks[(at.x + self.size.x * (at.y + self.size.y * at.z)) as usize]
    }

    /// What the submap knows of a voxel of the world; `None` where one of the voxels that count for it was never seen.
    fn look(&self, kind: VoxelKind, voxel: IVec3) -> Option<Seen<'a>> {
        let cell = Cell::at(self.placement.in_submap(voxel))?;
        let mut seen = Seen::default();
        let mut corners = [(0.0, &[][..], IVec3::ZERO); 8];
        for ((corner, voxel), share) in corners.iter_mut().zip(cell.voxels()).zip(cell.shares()) {
            // Those beyond a point that lies on the lattice: they may be unseen.
            if share == 0.0 {
                continue;
            }
            let words = self.block_around(voxel)?;
            let (distance, weight) = distance_in_block(kind, words, voxel);
            if weight == 0 {
                return None;
            }
            seen.distance += share * f64::from(distance);
            seen.weight += share * f64::from(weight);
            *corner = (share, words, voxel);
        }
        for (share, words, voxel) in corners.into_iter().filter(|(share, ..)| *share > 0.0) {
            let colour = colour_in_block(kind, words, voxel);
            let weight = share * f64::from(colour.weight());
            if weight > 0.0 {
                seen.colour_weight += weight;
                seen.colour += weight * DVec3::from(colour.rgb().map(f64::from));
            }
            seen.confidence += share * f64::from(confidence_in_block(kind, words, voxel));
            if share == 1.0 {
                seen.voxel = Some((words, index_in_block(voxel.rem_euclid(IVec3::splat(BLOCK_SIDE)))));
            }
        }
        Some(seen)
    }
}

/// What a submap knows at a point.
#[derive(Clone, Copy, Default)]
struct Seen<'a> {
    /// In units of the truncation band.
    distance: f64,
    weight: f64,
    /// Times its weight.
    colour: DVec3,
    colour_weight: f64,
    confidence: f64,
    /// Where the point is a voxel of the submap: the block's words, and the voxel's number in it.
    voxel: Option<(&'a [u32], usize)>,
}

/// Makes a block of the world from what submaps know of it, voxel by voxel: distances and colours are the means over the
/// submaps by their weights, weights and confidences the sums, up to `max_weight`.
pub(super) fn combine(
    kind: VoxelKind,
    world_block: IVec3,
    submaps: &[Surroundings<'_>],
    max_weight: u16,
    block: &mut [u32],
) {
    block.fill(0);
    for i in 0..BLOCK_VOXELS {
        let n = i as i32;
        let voxel = world_block * BLOCK_SIDE
            + IVec3::new(n % BLOCK_SIDE, n / BLOCK_SIDE % BLOCK_SIDE, n / (BLOCK_SIDE * BLOCK_SIDE));
        let mut seen = submaps.iter().filter_map(|submap| submap.look(kind, voxel));
        let Some(first) = seen.next() else { continue };
        let mut sum = Seen { distance: first.weight * first.distance, ..first };
        for other in seen {
            sum.distance += other.weight * other.distance;
            sum.weight += other.weight;
            sum.colour += other.colour;
            sum.colour_weight += other.colour_weight;
            sum.confidence += other.confidence;
            sum.voxel = None;
        }
        match sum.voxel {
            Some((words, index)) => copy_voxel(kind, words, index, block, i),
            None => write_voxel(kind, &sum, max_weight, block, i),
        }
    }
}

/// Copies a voxel to the bit.
fn copy_voxel(kind: VoxelKind, from: &[u32], index: usize, into: &mut [u32], at: usize) {
    let words = kind.distance_words();
    into[at * words..(at + 1) * words].copy_from_slice(&from[index * words..(index + 1) * words]);
    for plane in (words..kind.words()).map(|plane| plane * BLOCK_VOXELS) {
        into[plane + at] = from[plane + index];
    }
}

/// Writes a voxel from sums over submaps, distances times their weights.
fn write_voxel(kind: VoxelKind, sum: &Seen<'_>, max_weight: u16, block: &mut [u32], at: usize) {
    let max_weight = f64::from(max_weight);
    let counted = |weight: f64, most: f64| weight.round().min(most).max(1.0);
    let (distance, weight) = ((sum.distance / sum.weight) as f32, counted(sum.weight, max_weight) as u16);
    match kind.distance {
        DistanceKind::I16 => block[at] = DistanceVoxel::new(distance, weight).0,
        DistanceKind::F32 => {
            block[2 * at..2 * at + 2]
                .copy_from_slice(&bytemuck::cast::<FloatVoxel, [u32; 2]>(FloatVoxel::new(distance, weight)));
        }
    }
    if sum.colour_weight > 0.0 {
        let rgb = (sum.colour / sum.colour_weight).round().to_array().map(|c| c as u8);
        let weight = counted(sum.colour_weight, max_weight.min(255.0)) as u8;
        block[kind.colours_at() + at] = ColourVoxel::new(rgb, weight).0;
    }
    if kind.confidence {
        block[kind.confidences_at() + at] = (sum.confidence.min(max_weight) as f32).to_bits();
    }
}
