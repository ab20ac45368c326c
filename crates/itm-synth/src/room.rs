//! A furnished living room.

use glam::Vec3;

use crate::furniture::{Builder, Surfaces};
use crate::texture::colour;
use crate::{Lamp, Scene, Texture};

impl Scene {
    /// A furnished living room of 5 x 4 x 2.6 m.
    ///
    /// The world's origin lies on the floor in the middle; x points along the long side, y down, z along the short
    /// side. The ceiling is at y = -2.6. Free space for a camera is an ellipse of 0.6 x 0.45 m around the middle, from
    /// 1.25 to 1.6 m above the floor: no surface is nearer than 0.6 m there.
    pub fn room() -> Self {
        let mut room = Builder::new((5.0, 4.0), 2.6);
        let papered = Texture::Wallpaper { ground: colour(0xa9c2b4), flower: colour(0xd98a7b), size: 0.26 };
        let painted = Texture::Noise { a: colour(0xd7b98a), b: colour(0xe9d6b2), size: 0.5 };
        let bricks = Texture::Bricks { brick: colour(0xa9573f), mortar: colour(0xb9ad9c), length: 0.25 };
        let striped = Texture::Stripes { a: colour(0x7f95b5), b: colour(0xb4c2d6), size: 0.24 };
        let surfaces = Surfaces {
            floor: Texture::Planks { light: colour(0xc8935a), dark: colour(0x8f5c32), width: 0.14 }.into(),
            ceiling: Texture::Noise { a: colour(0xd9d4c8), b: colour(0xf2efe8), size: 0.35 }.into(),
            walls: [papered.into(), painted.into(), bricks.into(), striped.into()],
        };
        room.shell(&surfaces, &[-1.55, 0.0, 1.55]);
        room.ceiling_lamp(0.0, 0.0);
        room.window();
        room.door();
        room.sofa();
        room.coffee_table();
        room.bookshelf();
        room.dining_corner();
        room.sideboard();
        room.floor_lamp(2.12, 1.55);
        room.plant(-2.05, 1.55);
        room.toys();
        room.wall_decoration();
        let warm = Vec3::new(1.0, 0.9, 0.76);
        room.into_scene(vec![
            Lamp { position: Vec3::new(0.0, -2.3, 0.0), power: warm * 1.7 },
            Lamp { position: Vec3::new(2.12, -1.72, 1.55), power: warm * 0.35 },
            Lamp { position: Vec3::new(1.55, -1.6, -1.2), power: warm * 0.4 },
            Lamp { position: Vec3::new(2.2, -1.5, 0.35), power: Vec3::new(0.75, 0.88, 1.0) * 0.7 },
        ])
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::TAU;

    use super::*;
    use crate::Bounds;

    #[test]
    fn the_middle_of_the_room_is_free_and_walls_close_it() {
        let room = Scene::room();
        for i in 0..64 {
            let turn = TAU * i as f32 / 64.0;
            for (share, height) in [(1.0, 1.25), (1.0, 1.6), (0.5, 1.25), (0.0, 1.4)] {
                let p = Vec3::new(0.6 * share * turn.cos(), -height, 0.45 * share * turn.sin());
                assert!(room.distance(p) >= 0.6, "{} m at {p}", room.distance(p));
            }
        }
        let Bounds { min, max } = room.bounds();
        for corner in [min, max, Vec3::new(min.x, max.y, min.z), Vec3::new(max.x, min.y, max.z)] {
            let outside = corner + 0.05 * (corner - room.bounds().centre()).signum();
            assert!(room.distance(outside) < 0.0, "the room is open at {corner}");
        }
    }
}
