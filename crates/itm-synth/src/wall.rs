//! A room with a long bare wall.

use std::f32::consts::PI;

use glam::{Vec2, Vec3};

use crate::furniture::{Builder, Surfaces, cloth, plain};
use crate::texture::colour;
use crate::{Lamp, Material, Motif, Scene, Texture};

impl Scene {
    /// A room of 7 x 4 x 2.6 m whose wall at +z is bare for 4.2 m, from x = -2.1 to 2.1: nothing stands before it or
    /// hangs on it between the skirting and the ceiling's beams. Both of its ends are furnished.
    ///
    /// Axes are those of [`Scene::room`]. Free space for a camera is where [`Path::Wall`](crate::Path::Wall) leads. The
    /// wall's paint has blots that colour can be tracked by, and which repeat nowhere.
    pub fn wall() -> Self {
        Self::with_wall(cloth(0xb08d62, 0xe6d3ad, 0.3))
    }

    /// [`Scene::wall`] with the wall painted in one colour without any pattern: no more than the lamps' light, which falls
    /// off smoothly, tells its places apart.
    pub fn blank_wall() -> Self {
        Self::with_wall(Material { grain: 0.0, ..plain(0xd6c4a0) })
    }

    fn with_wall(bare: Material) -> Self {
        let mut room = Builder::new((7.0, 4.0), 2.6);
        let painted = Texture::Noise { a: colour(0xaebfc9), b: colour(0xcfdbe0), size: 0.5 };
        let bricks = Texture::Bricks { brick: colour(0xa9573f), mortar: colour(0xb9ad9c), length: 0.25 };
        let striped = Texture::Stripes { a: colour(0x7f95b5), b: colour(0xb4c2d6), size: 0.24 };
        let surfaces = Surfaces {
            floor: Texture::Planks { light: colour(0xc8935a), dark: colour(0x8f5c32), width: 0.14 }.into(),
            ceiling: Texture::Noise { a: colour(0xd9d4c8), b: colour(0xf2efe8), size: 0.35 }.into(),
            walls: [bare, painted.into(), bricks.into(), striped.into()],
        };
        room.shell(&surfaces, &[-2.3, 0.0, 2.3]);
        room.ceiling_lamp(0.0, 0.0);

        // The end at -x.
        room.put((-2.5, -0.1), (-3.5, 0.3), 0.0, Builder::bookshelf);
        room.plant(-3.1, 1.6);
        room.picture_on_z(-2.55, 2.0, -1.0, 1.2, Vec2::new(0.22, 0.3), Motif::Flowers);
        room.chair(Vec3::new(-2.7, 0.0, 1.45), 2.6, 0.0);
        // The end at +x.
        room.put((2.5, 0.35), (3.5, 0.2), 0.0, Builder::window);
        room.floor_lamp(3.15, 1.6);
        room.picture_on_z(2.6, 2.0, -1.0, 1.3, Vec2::new(0.3, 0.22), Motif::Landscape);
        room.soft((2.6, 1.72), 0.0, (0.7, 0.55, 0.42), 0.02, cloth(0x5b7d87, 0x9fbcc0, 0.1));
        room.vase((2.45, 1.72), 0.55, 0.3, 0xa23e48);
        room.lying_books((2.75, 1.7), 0.55, 4);
        // What stands opposite is seen by nobody who looks at the wall, but it is a room.
        room.put((-1.75, -2.0), (-2.6, -2.0), 0.0, Builder::door);
        room.put((-0.05, -2.0), (0.6, -2.0), 0.0, Builder::sideboard);
        room.picture_on_z(0.6, -2.0, 1.0, 1.42, Vec2::new(0.38, 0.27), Motif::Landscape);
        room.chair(Vec3::new(2.2, 0.0, -1.5), PI, 0.0);

        let warm = Vec3::new(1.0, 0.9, 0.76);
        room.into_scene(vec![
            Lamp { position: Vec3::new(0.0, -2.3, 0.0), power: warm * 1.7 },
            Lamp { position: Vec3::new(3.15, -1.72, 1.6), power: warm * 0.35 },
            Lamp { position: Vec3::new(-2.2, -2.2, 0.2), power: warm * 0.7 },
            Lamp { position: Vec3::new(3.1, -1.5, 0.2), power: Vec3::new(0.75, 0.88, 1.0) * 0.7 },
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_wall_is_bare_for_as_long_as_it_says() {
        for scene in [Scene::wall(), Scene::blank_wall()] {
            for i in 0..=84 {
                for height in [0.2, 0.8, 1.6, 2.3] {
                    let before = Vec3::new(-2.1 + 0.05 * i as f32, -height, 1.97);
                    let sample = scene.sample(before).unwrap();
                    assert!((sample.distance - 0.03).abs() < 1e-5, "{} m at {before}", sample.distance);
                    // Nor does anything hide it from a camera a metre away.
                    let in_front = before - 0.6 * Vec3::Z;
                    assert!(scene.distance(in_front) > 0.1, "{} m at {in_front}", scene.distance(in_front));
                }
            }
        }
    }

    #[test]
    fn the_blank_wall_has_no_pattern_and_is_the_same_otherwise() {
        let (textured, blank) = (Scene::wall(), Scene::blank_wall());
        assert_eq!(textured.objects().len(), blank.objects().len());
        let albedo = |scene: &Scene, x: f32| scene.sample(Vec3::new(x, -1.3, 1.99)).unwrap().albedo;
        for i in 0..40 {
            let x = -2.0 + 0.1 * i as f32;
            assert_eq!(albedo(&blank, x), albedo(&blank, 0.0));
        }
        assert!(albedo(&textured, 0.4).distance(albedo(&textured, 0.0)) > 0.005);
        for p in [Vec3::new(-2.4, -1.0, 0.2), Vec3::new(1.0, -0.9, -1.2), Vec3::new(2.6, -1.0, 1.4)] {
            assert_eq!(textured.sample(p), blank.sample(p));
        }
    }
}
