//! Two rooms side by side.

use glam::{Vec2, Vec3};

use crate::fittings::{Facing, Fitting};
use crate::furniture::{Builder, Surfaces, cloth};
use crate::texture::colour;
use crate::{Lamp, Material, Motif, Scene, Texture};

/// Half of the inner sides of both rooms together, and their height, in metres.
const HALF_X: f32 = 5.5;
const HALF_Z: f32 = 2.6;
const HEIGHT: f32 = 2.7;
/// Half of the passage's width, and its height.
const PASSAGE_HALF: f32 = 0.9;
const PASSAGE_HEIGHT: f32 = 2.15;

impl Scene {
    /// A living room at -x and a dining room at +x, 5.4 x 5.2 x 2.7 m each, with a passage of 1.8 m in the wall between
    /// them, and a table in the middle of each.
    ///
    /// The world's origin lies on the floor of the passage, y points down. Free space for a camera is where
    /// [`Path::Eight`](crate::Path::Eight) leads: around both tables, through the passage twice.
    pub fn two_rooms() -> Self {
        let mut rooms = Builder::new((2.0 * HALF_X, 2.0 * HALF_Z), HEIGHT);
        let papered = Texture::Wallpaper { ground: colour(0xd6c7a1), flower: colour(0x7f9a6b), size: 0.34 };
        let limed = Texture::Noise { a: colour(0xb9c4cf), b: colour(0xdfe4e6), size: 0.6 };
        let bricks = Texture::Bricks { brick: colour(0x9c6a4f), mortar: colour(0xc2b8a6), length: 0.25 };
        let striped = Texture::Stripes { a: colour(0x7f95b5), b: colour(0xb4c2d6), size: 0.24 };
        let surfaces = Surfaces {
            floor: Texture::Planks { light: colour(0xb98a58), dark: colour(0x7d5232), width: 0.16 }.into(),
            ceiling: Texture::Noise { a: colour(0xd9d4c8), b: colour(0xf2efe8), size: 0.35 }.into(),
            walls: [papered.into(), limed.into(), bricks.into(), striped.into()],
        };
        rooms.shell(&surfaces, &[-4.1, -2.3, 1.8, 3.9]);
        rooms.wall_with_passage();
        rooms.living_room();
        rooms.dining_room();

        let warm = Vec3::new(1.0, 0.9, 0.76);
        let mut lamps = vec![
            Lamp { position: Vec3::new(-5.1, -1.72, 2.2), power: warm * 0.4 },
            Lamp { position: Vec3::new(5.0, -1.5, -0.4), power: Vec3::new(0.75, 0.88, 1.0) },
        ];
        for x in [-2.8, 2.8] {
            rooms.ceiling_lamp(x, 0.9);
            lamps.push(Lamp { position: Vec3::new(x, -2.4, 0.9), power: warm * 1.9 });
        }
        rooms.into_scene(lamps)
    }
}

impl Builder {
    fn wall_with_passage(&mut self) {
        let plaster = cloth(0xc9b79a, 0xe9dcc3, 0.4);
        let side = HALF_Z - PASSAGE_HALF;
        for sign in [-1.0, 1.0] {
            self.block((0.0, sign * (PASSAGE_HALF + 0.5 * side)), 0.0, (0.2, HEIGHT, side), plaster);
            self.block((0.0, sign * PASSAGE_HALF), 0.0, (0.26, PASSAGE_HEIGHT, 0.08), crate::furniture::walnut());
        }
        self.block((0.0, 0.0), PASSAGE_HEIGHT, (0.2, HEIGHT - PASSAGE_HEIGHT, 2.0 * PASSAGE_HALF), plaster);
    }

    fn living_room(&mut self) {
        self.put((0.1, 2.0), (-2.6, HALF_Z), 0.0, Self::sofa);
        self.fit_wall(
            Facing::MinusZ,
            &[
                ((-3.1, HALF_Z), Fitting::Picture(Motif::Landscape)),
                ((-2.1, HALF_Z), Fitting::Picture(Motif::Abstract)),
                ((-0.7, HALF_Z), Fitting::Boxes(3)),
            ],
        );
        self.fit_wall(Facing::PlusX, &[((-HALF_X, 0.9), Fitting::Bookshelf), ((-HALF_X, -1.3), Fitting::Window)]);
        self.fit_wall(
            Facing::PlusZ,
            &[
                ((-4.4, -HALF_Z), Fitting::Door),
                ((-1.7, -HALF_Z), Fitting::Bookshelf),
                ((-0.4, -HALF_Z), Fitting::FloorLamp),
            ],
        );
        self.fit_wall(
            Facing::MinusX,
            &[
                ((-0.1, 2.05), Fitting::WallShelf),
                ((-0.1, 1.9), Fitting::Chest),
                ((-0.1, 1.3), Fitting::Pier(0.3, 0.25)),
                ((-0.1, -1.7), Fitting::WallShelf),
            ],
        );
        self.floor_lamp(-5.1, 2.2);
        self.put((0.05, 0.3), (-2.5, 0.0), 0.3, |b| {
            b.coffee_table();
        });
    }

    fn dining_room(&mut self) {
        self.put((1.55, -1.2), (2.6, 0.0), 0.7, Self::dining_corner);
        self.fit_wall(
            Facing::MinusZ,
            &[
                ((1.5, HALF_Z), Fitting::Sideboard),
                ((1.6, HALF_Z), Fitting::Picture(Motif::Flowers)),
                ((3.9, HALF_Z), Fitting::Window),
            ],
        );
        self.fit_wall(
            Facing::MinusX,
            &[
                ((HALF_X, -1.5), Fitting::Sideboard),
                ((HALF_X, -1.4), Fitting::Picture(Motif::Landscape)),
                ((HALF_X, 0.1), Fitting::Pier(0.5, 0.25)),
                ((HALF_X, 1.3), Fitting::Bench),
                ((HALF_X, 1.2), Fitting::WallShelf),
            ],
        );
        self.fit_wall(
            Facing::PlusZ,
            &[
                ((3.9, -HALF_Z), Fitting::Bookshelf),
                ((2.4, -HALF_Z), Fitting::Chair),
                ((2.3, -HALF_Z), Fitting::Picture(Motif::Abstract)),
                ((1.2, -HALF_Z), Fitting::Chest),
            ],
        );
        self.fit_wall(
            Facing::PlusX,
            &[
                ((0.1, 1.95), Fitting::Pier(0.3, 0.25)),
                ((0.1, 1.3), Fitting::Chest),
                ((0.1, 1.3), Fitting::WallShelf),
                ((0.1, -1.8), Fitting::Boxes(4)),
            ],
        );
        let half = Vec2::new(1.3, 1.0);
        let colours = [colour(0x31506b), colour(0x8c3b2e), colour(0xd9c79a)];
        let rug = Material { grain: 0.35, ..Texture::Rug { half, colours }.into() };
        self.block((2.6, 0.0), 0.0, (2.0 * half.x, 0.015, 2.0 * half.y), rug);
        self.plant(5.0, 2.2);
    }
}
