//! Reference of stage `allocate`: the blocks that a frame's depth asks for (the report, section 3.2; Nießner et al.
//! 2013, section 5.1).

use std::collections::HashSet;

use glam::{DVec2, DVec3, IVec3};
use itm_core::{Image, Intrinsics, Se3};

use super::map::{Block, Map, sort_by_cell};

/// The blocks that a depth image (metres, 0 where there is none) asks for: for each pixel those that the ray crosses
/// within the truncation band before and behind the measured point, as metres along the ray.
///
/// `margin` widens the blocks to all sides, as a share of their edge; a negative one narrows them.
pub fn requested(
    map: &Map,
    depth: &Image<f32>,
    camera: &Intrinsics,
    world_from_camera: &Se3,
    margin: f64,
) -> HashSet<IVec3> {
    let mut blocks = HashSet::new();
    for y in 0..depth.height() {
        for x in 0..depth.width() {
            let z = f64::from(depth[(x, y)]);
            if z > 0.0 {
                let ray = camera.unproject(DVec2::new(x.into(), y.into()), 1.0);
                let reach = f64::from(map.truncation_m) / ray.length();
                let [near, far] = [(z - reach).max(0.0), z + reach]
                    .map(|z| world_from_camera.transform_point(ray * z) / map.block_size_m());
                blocks.extend(crossed_blocks(near, far, margin));
            }
        }
    }
    blocks
}

/// Adds the blocks that a depth image asks for to the map, and lists those that are new, in the order in which they are
/// numbered: that of the grid's cells, x fastest.
pub fn allocate(map: &mut Map, depth: &Image<f32>, camera: &Intrinsics, world_from_camera: &Se3) -> Vec<IVec3> {
    let mut new = requested(map, depth, camera, world_from_camera, 0.0)
        .into_iter()
        .filter(|position| !map.blocks.contains_key(position))
        .collect::<Vec<_>>();
    sort_by_cell(&mut new);
    map.blocks.extend(new.iter().map(|position| (*position, Block::default())));
    new
}

/// The unit cubes that a segment crosses, each widened by `margin` to all sides.
pub fn crossed_blocks(from: DVec3, to: DVec3, margin: f64) -> Vec<IVec3> {
    // Every cube of the segment's bounding box is asked: slow, and plain to see.
    let first = (from.min(to) - margin).floor().as_ivec3();
    let last = (from.max(to) + margin).floor().as_ivec3();
    let mut crossed = Vec::new();
    for z in first.z..=last.z {
        for y in first.y..=last.y {
            for x in first.x..=last.x {
                let cube = IVec3::new(x, y, z);
                let lower = cube.as_dvec3() - margin;
                let upper = cube.as_dvec3() + 1.0 + margin;
                if crosses(from, to, lower, upper) {
                    crossed.push(cube);
                }
            }
        }
    }
    crossed
}

/// Whether a segment crosses a box, by the slab method (Kay & Kajiya 1986): the parts of it between each pair of faces
/// must overlap.
fn crosses(from: DVec3, to: DVec3, lower: DVec3, upper: DVec3) -> bool {
    let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
    for axis in 0..3 {
        let length = to[axis] - from[axis];
        if length == 0.0 {
            if from[axis] < lower[axis] || from[axis] >= upper[axis] {
                return false;
            }
        } else {
            let (a, b) = ((lower[axis] - from[axis]) / length, (upper[axis] - from[axis]) / length);
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
    }
    enter <= leave
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn point() -> impl Strategy<Value = DVec3> {
        [-3.0..3.0, -3.0..3.0, -3.0..3.0].prop_map(DVec3::from_array)
    }

    proptest! {
        #[test]
        fn every_point_of_a_segment_lies_in_a_crossed_block(from in point(), to in point(), t in 0.0..1.0) {
            let block = from.lerp(to, t).floor().as_ivec3();
            prop_assert!(crossed_blocks(from, to, 1e-12).contains(&block));
        }

        #[test]
        fn crossed_blocks_hold_a_point_of_the_segment(from in point(), to in point()) {
            for block in crossed_blocks(from, to, -0.01) {
                let centre = block.as_dvec3() + 0.5;
                // Some point of 4001 on the segment lies in the block: its narrowed twin is crossed, so the segment
                // stays in the block for at least 0.01 (or is shorter), and the points lie at most 10.4 / 4000 apart.
                let inside = (0..=4000).any(|i| {
                    let offset = from.lerp(to, f64::from(i) / 4000.0) - centre;
                    offset.abs().max_element() <= 0.5
                });
                prop_assert!(inside, "{block}");
            }
        }
    }
}
