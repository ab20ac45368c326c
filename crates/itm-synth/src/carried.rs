//! Something that is carried away while the camera looks on.

use glam::{DQuat, DVec3, Vec3};
use itm_core::Se3;

use crate::furniture::{cloth, plain};
use crate::{Object, Shape};

/// Sides of the box in metres: along x, upwards, along z.
pub(crate) const BOX_M: [f32; 3] = [0.36, 0.34, 0.32];
/// Where the middle of its bottom stands at first, on the floor.
const START: DVec3 = DVec3::new(-1.5, 0.0, -0.2);
/// From there to where it is out of view.
const WAY: DVec3 = DVec3::new(0.2, -0.7, -1.55);
/// When it is carried, in shares of the path's time.
const DURING: [f64; 2] = [0.3, 0.6];

/// Pose of the box, whose origin is the middle of its bottom, after a share of the path's time.
pub(crate) fn world_from_box(share: f64) -> Se3 {
    let at = ((share - DURING[0]) / (DURING[1] - DURING[0])).clamp(0.0, 1.0);
    // From rest to rest: lifted first, then taken along.
    let smooth = |t: f64| t * t * t * (t * (6.0 * t - 15.0) + 10.0);
    let lifted = smooth((2.0 * at).min(1.0));
    let along = smooth(at);
    let place = START + WAY * DVec3::new(along, lifted, along);
    Se3::new(DQuat::from_rotation_y(0.5 + 0.9 * along), place)
}

/// The box as it is after a share of the path's time: cardboard with two strips of tape.
pub(crate) fn carton(share: f64) -> Vec<Object> {
    let [x, y, z] = BOX_M;
    let solid = |size: [f32; 3], material: crate::Material| {
        Object::new(Shape::cuboid(size[0], size[1], size[2]), material).at(0.0, -0.5 * y, 0.0)
    };
    let pieces = [
        solid(BOX_M, cloth(0xb98d5a, 0xa67a48, 0.12)),
        solid([x + 0.004, y + 0.004, 0.06], plain(0x3c6e9f)),
        solid([0.06, y + 0.004, z + 0.004], plain(0xd7d2c4)),
    ];
    let pose = world_from_box(share);
    let (to, turn) = (pose.translation.as_vec3(), pose.rotation.as_quat());
    pieces.map(|piece| piece.seeded(77).moved(Vec3::ZERO, to, turn)).to_vec()
}

#[cfg(test)]
mod tests {
    use itm_core::DepthImage;

    use super::*;
    use crate::{Path, Sequence, Spec};

    /// Share of a frame's pixels that see the box, where the scene without it is seen at exactly the same depth elsewhere.
    fn share_of_box(sequence: &Sequence, index: u32) -> f64 {
        let frame = sequence.frame(index);
        let DepthImage::Metres(depth) = &frame.depth else { panic!("metres") };
        let pose = sequence.world_from_camera(index);
        let (without, _) = crate::render_depth(sequence.scene(), &sequence.spec().camera, &pose);
        let nearer = depth.data().iter().zip(without.data()).filter(|(with, without)| {
            assert!(**with <= **without + 2e-4, "something stands behind what stays");
            **with < **without - 2e-4
        });
        nearer.count() as f64 / depth.data().len() as f64
    }

    #[test]
    fn the_box_stands_there_is_carried_and_out_of_view_then() {
        let sequence = Sequence::new(Spec::new(Path::Carried).with_size(160, 120)).unwrap();
        for (index, shares) in [(0, 0.02..0.2), (71, 0.02..0.2), (95, 0.02..0.2), (144, 0.0..1e-9), (239, 0.0..1e-9)] {
            let share = share_of_box(&sequence, index);
            assert!(shares.contains(&share), "frame {index}: {share}");
        }
        let at = |index: u32| world_from_box(f64::from(index) / 240.0);
        assert_eq!(at(0), at(72));
        assert!(at(94).translation.y < -f64::from(BOX_M[1]), "it has left its place");
        assert!((1..240).all(|i| at(i).translation.distance(at(i - 1).translation) < 0.06), "no faster than 1.8 m/s");
    }
}
