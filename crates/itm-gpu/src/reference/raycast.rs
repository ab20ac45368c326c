//! Reference of stage `raycast`: the surface that each pixel sees (the report, section 3.4; Newcombe et al. 2011,
//! section 3.3).

use glam::{DVec2, DVec3};
use itm_core::voxel::BLOCK_SIDE;
use itm_core::{Image, Intrinsics, Se3};

use super::map::{Map, block_of};
use super::ranges::PIXELS_PER_RANGE;

/// Where a ray enters a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// World frame, metres.
    pub point: DVec3,
    /// The smallest weight of the eight voxels around the place from which the last refining step led here.
    pub weight: u16,
}

/// A hit's distance from the surface before the last step, in truncation bands, is at most this.
pub const LARGEST_REST: f64 = 0.25;

/// Casts a ray for each pixel within the depths that the range image (see [`super::ranges`]) gives, but not nearer than
/// `near_m`.
///
/// Along a ray the nearest voxel's distance says how far the next step may go: it shrinks towards the surface. Where there
/// is no block, a step leads to the next block's border; where no voxel has been seen yet, it is the truncation band. A
/// surface is where distances change from positive to negative, refined by three steps, the last two of interpolated
/// distances.
pub fn raycast(
    map: &Map,
    ranges: &Image<Option<[f32; 2]>>,
    camera: &Intrinsics,
    world_from_camera: &Se3,
    near_m: f32,
) -> Image<Option<Hit>> {
    Image::from_fn(camera.width, camera.height, |x, y| {
        let [near, far] = ranges[(x / PIXELS_PER_RANGE, y / PIXELS_PER_RANGE)]?;
        let ray = camera.unproject(DVec2::new(x.into(), y.into()), 1.0);
        let direction = world_from_camera.transform_vector(ray.normalize());
        let [start, end] = [near.max(near_m), far].map(|z| f64::from(z) * ray.length());
        cast_ray(map, world_from_camera.translation, direction, start, end)
    })
}

/// Follows a ray from a point along a unit direction (world frame), between two distances from the point, all in metres.
pub fn cast_ray(map: &Map, origin: DVec3, direction: DVec3, start: f64, end: f64) -> Option<Hit> {
    // In voxels from here on.
    let voxel_size = f64::from(map.voxel_size_m);
    let at = |t: f64| origin / voxel_size + t * direction;
    let (start, end) = (start / voxel_size, end / voxel_size);
    let band = f64::from(map.truncation_m) / voxel_size;

    let mut in_front = false;
    let mut t = start;
    while t < end {
        let position = at(t);
        let nearest = (position + 0.5).floor().as_ivec3();
        let voxel = map.distance(nearest);
        let distance = f64::from(voxel.distance());
        if !map.blocks.contains_key(&block_of(nearest)) {
            in_front = false;
            // A little beyond the border, so that rounding does not keep the ray on this side.
            t += way_through_block(position + 0.5, direction) + 0.01;
        } else if voxel.weight() == 0 {
            // Never seen: neither in front of a surface nor behind one.
            in_front = false;
            t += band;
        } else if distance <= 0.0 && in_front {
            return refine(map, &at, t + distance * band, band);
        } else {
            in_front = distance > 0.0;
            t += (distance.abs() * band).max(1.0);
        }
    }
    None
}

/// How far it is from a position, in voxels, along a unit direction to the border of the block that it lies in.
fn way_through_block(position: DVec3, direction: DVec3) -> f64 {
    let side = f64::from(BLOCK_SIDE);
    let from_corner = position - (position / side).floor() * side;
    (0..3)
        .filter(|axis| direction[*axis] != 0.0)
        .map(|axis| {
            let border = if direction[axis] > 0.0 { side } else { 0.0 };
            (border - from_corner[axis]) / direction[axis]
        })
        .fold(f64::INFINITY, f64::min)
}

/// Two more steps from close to the surface. There is no hit where one of the eight voxels around was never seen, or where
/// the first step has not led to the surface, as at an object's outline, where distances of front and side are mixed.
fn refine(map: &Map, at: &impl Fn(f64) -> DVec3, t: f64, band: f64) -> Option<Hit> {
    let t = t + map.interpolate(at(t)).0 * band;
    let (distance, weight) = map.interpolate(at(t));
    let hit = at(t + distance * band) * f64::from(map.voxel_size_m);
    (weight > 0 && distance.abs() <= LARGEST_REST).then_some(Hit { point: hit, weight })
}

#[cfg(test)]
mod tests {
    use glam::IVec3;
    use itm_core::voxel::{BLOCK_VOXELS, DistanceVoxel};

    use super::super::map::Block;
    use super::*;
    use crate::reference::integrate::voxel_in_map;

    /// A wall at z = 1.003 m, of blocks within 0.2 m of the z axis.
    fn wall() -> Map {
        let mut map = Map::new(0.01, 0.04);
        for z in 11..14 {
            for (x, y) in (-3..3).flat_map(|x| (-3..3).map(move |y| (x, y))) {
                let position = IVec3::new(x, y, z);
                let mut block = Block::default();
                for i in 0..BLOCK_VOXELS {
                    let eta = 1.003 - voxel_in_map(position, i).z as f32 * 0.01;
                    if eta >= -0.04 {
                        block.distances[i] = DistanceVoxel::new(eta / 0.04, 7);
                    }
                }
                map.blocks.insert(position, block);
            }
        }
        map
    }

    #[test]
    fn rays_meet_a_wall_from_the_front_but_not_from_behind() {
        let map = wall();
        for direction in [DVec3::Z, DVec3::new(0.1, -0.05, 1.0).normalize()] {
            let hit = cast_ray(&map, DVec3::ZERO, direction, 0.2, 3.0).unwrap();
            // Half a step of the fixed-point numbers is 6e-7 m. Where the ray is slanted, the last step goes less far than it
            // should, from at most a voxel's edge away.
            let tolerance = 1e-6 + (1.0 - direction.z) * 0.01;
            assert!((hit.point.z - 1.003).abs() < tolerance, "{}", hit.point);
            assert_eq!(hit.weight, 7);
        }
        assert_eq!(cast_ray(&map, DVec3::new(0.0, 0.0, 2.0), DVec3::NEG_Z, 0.0, 3.0), None);
        assert_eq!(cast_ray(&map, DVec3::ZERO, DVec3::Z, 0.2, 0.9), None, "the ray ends before the wall");
        assert_eq!(cast_ray(&map, DVec3::ZERO, DVec3::X, 0.2, 3.0), None);
    }
}
