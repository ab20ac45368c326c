//! Reference of stage `raycast`: the surface that each pixel sees (the report, section 3.4; Newcombe et al. 2011,
//! section 3.3).

use glam::{DVec2, DVec3};
use itm_core::{Image, Intrinsics, Se3};

use super::map::{Map, block_of};
use super::ranges::PIXELS_PER_RANGE;

/// Where a ray enters a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// World frame, metres.
    pub point: DVec3,
    /// The smallest weight of the eight voxels around.
    pub weight: u16,
}

/// A hit's distance from the surface, in truncation bands, is at most this.
pub const LARGEST_REST: f64 = 0.25;

/// What a ray has met last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// No block for as long as a coarse step.
    Nothing,
    /// No voxel that was ever seen, but a block is near.
    Unseen,
    /// Space in front of a surface.
    InFront,
    /// Space behind a surface, entered from its back or its side.
    Inside,
}

/// Casts a ray for each pixel within the depths that the range image (see [`super::ranges`]) gives, but not nearer than
/// `near_m`.
///
/// Along a ray the distances say how far the next step may go: they shrink towards the surface. Where there is no block,
/// steps are a block's side long; where no voxel has been seen yet, the truncation band. A surface is where distances
/// change from positive to negative, refined by two more steps of the interpolated distance.
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
    let block_side = f64::from(itm_core::voxel::BLOCK_SIDE);

    let mut state = State::Nothing;
    // Up to where short steps are taken through space without blocks.
    let mut search_until = 0.0;
    let mut t = start;
    while t < end {
        let position = at(t);
        let nearest = (position + 0.5).floor().as_ivec3();
        if !map.blocks.contains_key(&block_of(nearest)) {
            if state == State::Unseen && t <= search_until {
                t += band;
            } else {
                state = State::Nothing;
                t += block_side;
            }
            continue;
        }
        if state == State::Nothing {
            // The long step that led here may have jumped over the beginning of the surface: search it again.
            state = State::Unseen;
            search_until = t;
            t = (t - block_side).max(start);
            continue;
        }
        let voxel = map.distance(nearest);
        if voxel.weight() == 0 {
            state = State::Unseen;
            search_until = t;
            t += band;
            continue;
        }
        let mut distance = f64::from(voxel.distance());
        if (-0.5..=0.1).contains(&distance) {
            // Near the surface the nearest voxel is too coarse.
            distance = map.interpolate(position).0;
        }
        if distance > 0.0 {
            state = State::InFront;
        } else if state == State::InFront {
            return refine(map, &at, t + distance * band, band);
        } else {
            state = State::Inside;
            search_until = t;
        }
        t += (distance.abs() * band).max(1.0);
    }
    None
}

/// One more step from close to the surface. There is no hit where one of the eight voxels around was never seen, or where
/// that step has not led to the surface, as at an object's outline, where distances of front and side are mixed.
fn refine(map: &Map, at: &impl Fn(f64) -> DVec3, t: f64, band: f64) -> Option<Hit> {
    let t = t + map.interpolate(at(t)).0 * band;
    let (distance, weight) = map.interpolate(at(t));
    (weight > 0 && distance.abs() <= LARGEST_REST).then(|| Hit { point: at(t) * f64::from(map.voxel_size_m), weight })
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
            // Half a step of the fixed-point numbers is 6e-7 m; the slant slows the two refining steps down.
            assert!((hit.point.z - 1.003).abs() < 1e-5, "{}", hit.point);
            assert_eq!(hit.weight, 7);
        }
        assert_eq!(cast_ray(&map, DVec3::new(0.0, 0.0, 2.0), DVec3::NEG_Z, 0.0, 3.0), None);
        assert_eq!(cast_ray(&map, DVec3::ZERO, DVec3::Z, 0.2, 0.9), None, "the ray ends before the wall");
        assert_eq!(cast_ray(&map, DVec3::ZERO, DVec3::X, 0.2, 3.0), None);
    }
}
