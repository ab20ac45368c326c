//! Where a submap's blocks lie on the world's lattice, and the other way round.

use glam::{DMat3, DVec3, IVec3};
use itm_core::Se3;
use itm_core::sample::block_of;
use itm_core::voxel::BLOCK_SIDE;

/// A point so near to a voxel, in voxels, is taken to lie on it: 16 bits of distance cannot tell. So submaps that differ by
/// whole voxels lose nothing to the rounding of their poses.
const SNAP: f64 = 1e-4;
/// Half of it, which bounds keep as a margin for rounding.
const MARGIN: f64 = 0.5 * SNAP;

/// A submap's pose in voxels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placement {
    pub(super) submap: u16,
    /// Whether the submap's own frame is the world.
    pub(super) is_world: bool,
    submap_from_world: DMat3,
    /// Where the world's origin lies in the submap.
    origin: DVec3,
}

impl Placement {
    pub(super) fn new(submap: u16, world_from_submap: &Se3, voxel_size_m: f64) -> Self {
        let submap_from_world = world_from_submap.inverse();
        Self {
            submap,
            is_world: *world_from_submap == Se3::IDENTITY,
            submap_from_world: DMat3::from_quat(submap_from_world.rotation),
            origin: submap_from_world.translation / voxel_size_m,
        }
    }

    /// Where a voxel of the world lies in the submap, in voxels.
    pub(super) fn in_submap(&self, voxel: IVec3) -> DVec3 {
        let position = self.submap_from_world * voxel.as_dvec3() + self.origin;
        let nearest = position.round();
        DVec3::select((position - nearest).abs().cmplt(DVec3::splat(SNAP)), nearest, position)
    }

    /// The first and last of the submap's blocks that interpolation at a world block's voxels may read.
    pub(super) fn blocks_for(&self, world_block: IVec3) -> [IVec3; 2] {
        let [low, high] = self.bounds_in_submap(world_block);
        let (first, last) = ((low + MARGIN).floor().as_ivec3(), (high - MARGIN).ceil().as_ivec3());
        // No others have numbers.
        let (least, most) = (IVec3::splat(i16::MIN.into()), IVec3::splat(i16::MAX.into()));
        [block_of(first).max(least), block_of(last).min(most)]
    }

    /// The world blocks with a voxel, or nearly so, in one of the submap's blocks: in the cubes of eight voxels whose lowest
    /// corner is in the block. Along an axis whose next block is missing (`ends`) there are no cubes beyond the last voxels,
    /// only these. `None` where it or they lie further out than blocks can be numbered, or next to that.
    pub(super) fn reached(&self, block: IVec3, ends: [bool; 3]) -> Option<impl Iterator<Item = IVec3>> {
        let side = f64::from(BLOCK_SIDE);
        let low = block.as_dvec3() * side;
        let high = low + DVec3::from(ends.map(|ends| if ends { side - 1.0 + MARGIN } else { side - MARGIN }));
        let low = low - MARGIN;
        let world_from_submap = self.submap_from_world.transpose();
        let [first, last] = turned_box(world_from_submap, world_from_submap * -self.origin, low, high);
        // As far as cells of voxels are found on either side: see `Cell::at`.
        let reach = f64::from(i16::MAX - 1) * side;
        if ![first, last, low, high].iter().all(|corner| corner.abs().max_element() <= reach) {
            return None;
        }
        let (first, last) = (block_of(first.ceil().as_ivec3()), block_of(last.floor().as_ivec3()));
        let this = *self;
        Some(positions(first, last).filter(move |&world_block| {
            let [first, last] = this.bounds_in_submap(world_block);
            last.cmpge(low).all() && first.cmple(high).all()
        }))
    }

    /// Smallest and largest coordinates that a world block's voxels have in the submap, in voxels.
    fn bounds_in_submap(&self, world_block: IVec3) -> [DVec3; 2] {
        let low = (world_block * BLOCK_SIDE).as_dvec3();
        turned_box(self.submap_from_world, self.origin, low, low + f64::from(BLOCK_SIDE - 1))
    }
}

/// All positions from the first to the last, x fastest.
pub(super) fn positions(first: IVec3, last: IVec3) -> impl Iterator<Item = IVec3> {
    let along = move |axis: usize| first[axis]..=last[axis];
    along(2).flat_map(move |z| along(1).flat_map(move |y| along(0).map(move |x| IVec3::new(x, y, z))))
}

/// The box along the axes around a box that has been turned and then moved.
fn turned_box(rotation: DMat3, translation: DVec3, low: DVec3, high: DVec3) -> [DVec3; 2] {
    let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
    let middle = rotation * middle + translation;
    let half = rotation.abs() * half;
    [middle - half, middle + half]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    fn voxels(block: IVec3) -> impl Iterator<Item = IVec3> {
        (0..512).map(move |i| block * BLOCK_SIDE + IVec3::new(i & 7, i >> 3 & 7, i >> 6))
    }

    #[test]
    fn a_world_block_is_reached_by_all_blocks_that_its_voxels_lie_in() {
        let poses = [
            Se3::IDENTITY,
            Se3::exp([0.3, -0.2, 0.11, 0.0, 0.35, 0.0]),
            Se3::exp([-1.3, 0.005, 0.4, 0.8, -0.35, 1.9]),
            Se3::exp([0.015, -0.025, 0.035, 0.0, 0.0, 0.0]),
        ];
        for pose in poses {
            let placement = Placement::new(3, &pose, 0.01);
            let block = IVec3::new(-2, 5, 1);
            let reached: HashSet<_> = placement.reached(block, [false; 3]).unwrap().collect();
            let mut within = HashSet::new();
            let middle = pose.transform_point((block * 8 + 4).as_dvec3() * 0.01) / 0.01;
            let middle = block_of(middle.round().as_ivec3());
            for offset in (0..125).map(|i| IVec3::new(i % 5, i / 5 % 5, i / 25) - 2) {
                for voxel in voxels(middle + offset) {
                    let base = placement.in_submap(voxel).floor().as_ivec3();
                    if block_of(base) == block {
                        within.insert(middle + offset);
                        let [first, last] = placement.blocks_for(middle + offset);
                        assert!(block.cmpge(first).all() && block.cmple(last).all());
                    }
                }
            }
            assert!(within.is_subset(&reached), "{within:?} of {reached:?}");
            // In two blocks' boxes that only touch near their edges there need be no voxel of both.
            assert!(reached.len() <= within.len() + 4, "{} for {} at {pose:?}", reached.len(), within.len());
        }
    }

    #[test]
    fn the_same_lattice_needs_no_neighbours() {
        let placement = Placement::new(0, &Se3::IDENTITY, f64::from(0.01_f32));
        let block = IVec3::new(4, -7, 32_765);
        assert_eq!(placement.reached(block, [false; 3]).unwrap().collect::<Vec<_>>(), [block]);
        assert_eq!(placement.blocks_for(block), [block, block]);
        // By whole voxels, if in numbers that are none.
        let moved = Se3 { translation: DVec3::new(0.08, -0.24, 0.0), ..Se3::IDENTITY };
        let placement = Placement::new(0, &moved, f64::from(0.01_f32));
        assert_eq!(placement.reached(IVec3::ZERO, [false; 3]).unwrap().collect::<Vec<_>>(), [IVec3::new(1, -3, 0)]);
        assert_eq!(placement.in_submap(IVec3::new(8, -24, 5)), DVec3::new(0.0, 0.0, 5.0));
    }

    #[test]
    fn blocks_without_a_number_are_told() {
        let far = Se3 { translation: DVec3::new(0.0, 1e300, 0.0), ..Se3::IDENTITY };
        assert!(Placement::new(0, &far, 0.01).reached(IVec3::ZERO, [true; 3]).is_none());
        let far = Se3 { translation: DVec3::new(0.0, 0.01 * 8.0, 0.0), ..Se3::IDENTITY };
        let last = IVec3::new(0, 32_765, 0);
        assert!(Placement::new(0, &far, 0.01).reached(last, [true; 3]).is_none());
    }
}
