//! A hall as large as a flat.

use std::f32::consts::{FRAC_PI_2, PI};

use glam::{Vec2, Vec3};

use crate::furniture::{Builder, Surfaces, cloth, oak, walnut};
use crate::texture::colour;
use crate::{Lamp, Motif, Scene, Texture};

impl Scene {
    /// A furnished hall of 9 x 7 x 2.8 m: a sofa and its table, a dining table in the middle, shelves, cupboards,
    /// windows.
    ///
    /// Axes are those of [`Scene::room`]. Free space for a camera is where [`Path::Hall`](crate::Path::Hall) leads: half
    /// an ellipse around the dining table, 1.3 to 1.5 m above the floor.
    pub fn hall() -> Self {
        let mut hall = Builder::new((9.0, 7.0), 2.8);
        let limed = Texture::Noise { a: colour(0xb9c4cf), b: colour(0xdfe4e6), size: 0.6 };
        let papered = Texture::Wallpaper { ground: colour(0xd6c7a1), flower: colour(0x7f9a6b), size: 0.34 };
        let bricks = Texture::Bricks { brick: colour(0x9c6a4f), mortar: colour(0xc2b8a6), length: 0.25 };
        let striped = Texture::Stripes { a: colour(0x9aa88f), b: colour(0xc9d1bd), size: 0.3 };
        let surfaces = Surfaces {
            floor: Texture::Planks { light: colour(0xb98a58), dark: colour(0x7d5232), width: 0.16 }.into(),
            ceiling: Texture::Noise { a: colour(0xd9d4c8), b: colour(0xf2efe8), size: 0.35 }.into(),
            walls: [papered.into(), limed.into(), bricks.into(), striped.into()],
        };
        hall.shell(&surfaces, &[-3.0, -1.5, 0.0, 1.5, 3.0]);
        for x in [-3.0, 0.0, 3.0] {
            hall.ceiling_lamp(x, 0.0);
        }

        // A place to sit, at +z, and one to read beside it.
        hall.put((0.1, 2.0), (-1.7, 3.5), 0.0, |b| {
            b.sofa();
            b.coffee_table();
            for (x, height, half, motif) in [
                (-0.45, 1.25, Vec2::new(0.5, 0.36), Motif::Landscape),
                (0.6, 1.35, Vec2::new(0.28, 0.36), Motif::Flowers),
            ] {
                b.picture_on_z(x, 2.0, -1.0, height, half, motif);
            }
        });
        hall.put((-2.5, -0.1), (0.95, 3.5), FRAC_PI_2, Builder::bookshelf);
        hall.put((2.5, 0.35), (3.2, 3.5), -FRAC_PI_2, Builder::window);
        // The dining table stands in the middle.
        hall.put((1.55, -1.2), (-0.4, 0.0), 0.5, Builder::dining_corner);
        // The wall at -z.
        hall.put((-1.75, -2.0), (-3.7, -3.5), 0.0, Builder::door);
        hall.put((-0.05, -2.0), (-0.9, -3.5), 0.0, |b| {
            b.sideboard();
            b.picture_on_z(-0.12, -2.0, 1.0, 1.4, Vec2::new(0.25, 0.34), Motif::Abstract);
            b.picture_on_z(0.7, -2.0, 1.0, 1.42, Vec2::new(0.46, 0.33), Motif::Landscape);
        });
        hall.put((-2.5, -0.1), (1.9, -3.5), -FRAC_PI_2, Builder::bookshelf);
        // The wall at -x.
        hall.put((-2.5, -0.1), (-4.5, 1.9), 0.0, Builder::bookshelf);
        hall.put((-0.05, -2.0), (-4.5, -0.7), FRAC_PI_2, |b| {
            b.sideboard();
            b.picture_on_z(0.1, -2.0, 1.0, 1.35, Vec2::new(0.4, 0.3), Motif::Flowers);
        });
        // The wall at +x.
        hall.put((2.5, 0.35), (4.5, 1.5), 0.0, Builder::window);
        hall.put((2.5, 0.35), (4.5, -1.9), 0.0, Builder::window);
        hall.put((0.0, -2.0), (4.5, -0.2), -FRAC_PI_2, |b| {
            b.picture_on_z(0.0, -2.0, 1.0, 1.25, Vec2::new(0.3, 0.42), Motif::Landscape);
        });
        hall.soft((4.25, -0.2), 0.0, (0.42, 0.5, 0.9), 0.02, walnut());
        hall.vase((4.25, -0.35), 0.5, 0.3, 0x2d7f8a);
        hall.lying_books((4.25, 0.02), 0.5, 4);

        hall.plant(4.0, -3.0);
        hall.plant(-4.0, -2.2);
        hall.plant(2.15, 3.05);
        hall.floor_lamp(-4.1, 3.1);
        hall.floor_lamp(4.1, 3.1);
        hall.put((0.0, 0.0), (2.35, -0.9), 0.2, Builder::toys);
        hall.chair(Vec3::new(3.3, 0.0, 1.5), 0.6, 0.0);
        hall.chair(Vec3::new(0.6, 0.0, -2.7), PI, 0.0);
        // A bench with a basket in front of the window at +z.
        hall.soft((3.2, 2.9), 0.36, (1.3, 0.06, 0.36), 0.02, oak());
        for x in [2.65, 3.75] {
            hall.block((x, 2.9), 0.0, (0.06, 0.37, 0.3), oak());
        }
        hall.soft((3.5, 2.9), 0.42, (0.4, 0.2, 0.3), 0.06, cloth(0x8d6e8f, 0xd8c4d6, 0.07));

        // A low bench with books and a bowl on a rug.
        let (x, z) = (1.5, -0.1);
        let half = Vec2::new(1.1, 0.8);
        let colours = [colour(0x31506b), colour(0x8c3b2e), colour(0xd9c79a)];
        hall.block((x, z), 0.0, (2.0 * half.x, 0.015, 2.0 * half.y), Texture::Rug { half, colours }.into());
        hall.soft((x, z), 0.0, (1.2, 0.42, 0.5), 0.03, cloth(0x7a4b3a, 0xb98a6a, 0.1));
        hall.lying_books((x - 0.3, z), 0.42, 5);
        hall.bowl_of_fruit((x + 0.25, z), 0.42);

        let warm = Vec3::new(1.0, 0.9, 0.76);
        let day = Vec3::new(0.75, 0.88, 1.0);
        hall.into_scene(vec![
            Lamp { position: Vec3::new(-3.0, -2.5, 0.0), power: warm * 1.9 },
            Lamp { position: Vec3::new(0.0, -2.5, 0.0), power: warm * 1.6 },
            Lamp { position: Vec3::new(3.0, -2.5, 0.0), power: warm * 1.9 },
            Lamp { position: Vec3::new(-4.1, -1.72, 3.1), power: warm * 0.4 },
            Lamp { position: Vec3::new(4.0, -1.5, -0.2), power: day * 1.0 },
        ])
    }
}
