//! A long corridor.

use glam::{Vec2, Vec3};

use crate::fittings::{Facing, Fitting, PANEL_M};
use crate::furniture::{Builder, Surfaces, cloth, plain};
use crate::texture::colour;
use crate::{Lamp, Motif, Scene, Texture};

/// Half of the corridor's sides in metres.
const HALF_LENGTH: f32 = 15.0;
const HALF_WIDTH: f32 = 1.2;

/// Along the wall at +z, by x.
const FAR_SIDE: [(f32, Fitting); 27] = [
    (-13.8, Fitting::Bookshelf),
    (-12.55, Fitting::Pier(0.35, 0.22)),
    (-11.7, Fitting::Bench),
    (-11.6, Fitting::Picture(Motif::Landscape)),
    (-9.6, Fitting::Door),
    (-8.75, Fitting::FloorLamp),
    (-7.5, Fitting::Sideboard),
    (-7.3, Fitting::Picture(Motif::Abstract)),
    (-6.3, Fitting::Pier(0.5, 0.16)),
    (-4.9, Fitting::Window),
    (-3.3, Fitting::Boxes(3)),
    (-2.55, Fitting::Pier(0.3, 0.3)),
    (-1.2, Fitting::Bookshelf),
    (0.35, Fitting::Picture(Motif::Flowers)),
    (0.4, Fitting::Chair),
    (2.4, Fitting::Door),
    (3.4, Fitting::Chest),
    (3.35, Fitting::Picture(Motif::Abstract)),
    (4.2, Fitting::Pier(0.42, 0.2)),
    (5.3, Fitting::WallShelf),
    (5.35, Fitting::Bench),
    (6.7, Fitting::Boxes(4)),
    (8.1, Fitting::Sideboard),
    (9.35, Fitting::Pier(0.3, 0.25)),
    (9.95, Fitting::Chest),
    (11.5, Fitting::Window),
    (13.7, Fitting::Bookshelf),
];

/// Along the wall at -z, by x.
const NEAR_SIDE: [(f32, Fitting); 27] = [
    (-14.4, Fitting::Boxes(3)),
    (-13.2, Fitting::Chest),
    (-13.1, Fitting::WallShelf),
    (-12.0, Fitting::Pier(0.3, 0.2)),
    (-10.6, Fitting::Window),
    (-9.0, Fitting::Boxes(4)),
    (-7.9, Fitting::Pier(0.55, 0.18)),
    (-7.0, Fitting::Chair),
    (-6.9, Fitting::Picture(Motif::Flowers)),
    (-5.6, Fitting::Door),
    (-3.2, Fitting::Sideboard),
    (-1.9, Fitting::Pier(0.32, 0.28)),
    (-0.9, Fitting::Bench),
    (-0.8, Fitting::WallShelf),
    (0.8, Fitting::Boxes(2)),
    (0.9, Fitting::Picture(Motif::Landscape)),
    (2.6, Fitting::Bookshelf),
    (4.0, Fitting::FloorLamp),
    (5.2, Fitting::Door),
    (7.2, Fitting::Pier(0.4, 0.24)),
    (8.1, Fitting::Chest),
    (8.0, Fitting::Picture(Motif::Abstract)),
    (9.6, Fitting::Window),
    (11.2, Fitting::Pier(0.3, 0.3)),
    (12.1, Fitting::Boxes(4)),
    (13.5, Fitting::Sideboard),
    (13.3, Fitting::Picture(Motif::Landscape)),
];

impl Scene {
    /// A furnished corridor of 30 x 2.4 x 2.6 m, no two places of which look alike: doors, windows, piers, shelves,
    /// benches and boxes stand close enough for depth to tell everywhere how far along a camera is.
    ///
    /// The world's origin lies on the floor in the middle; x points along the corridor, y down. Free space for a camera
    /// is within 0.15 m of the middle line from x = -13.3 to 13.3, 1.3 to 1.5 m above the floor.
    pub fn corridor() -> Self {
        let mut corridor = Builder::new((2.0 * HALF_LENGTH, 2.0 * HALF_WIDTH), 2.6);
        let limed = cloth(0xb9c4cf, 0xdfe4e6, 0.6);
        let surfaces = Surfaces {
            floor: Texture::Planks { light: colour(0xc8935a), dark: colour(0x8f5c32), width: 0.13 }.into(),
            ceiling: Texture::Noise { a: colour(0xd9d4c8), b: colour(0xf2efe8), size: 0.35 }.into(),
            walls: [limed, limed, cloth(0xa9c2b4, 0xd7d2b0, 0.4), cloth(0xb08d62, 0xe6d3ad, 0.3)],
        };
        let beams = [-14.2, -11.9, -8.6, -6.4, -2.9, -0.4, 2.9, 4.7, 7.6, 10.9, 12.3, 14.3];
        corridor.shell(&surfaces, &beams);
        corridor.panel_wall((-HALF_LENGTH, HALF_LENGTH), HALF_WIDTH, Facing::MinusZ);
        corridor.panel_wall((-HALF_LENGTH, HALF_LENGTH), -HALF_WIDTH, Facing::PlusZ);
        let before_panels = HALF_WIDTH - PANEL_M;
        for (facing, z, fittings) in
            [(Facing::MinusZ, before_panels, &FAR_SIDE[..]), (Facing::PlusZ, -before_panels, &NEAR_SIDE[..])]
        {
            for &(x, fitting) in fittings {
                corridor.fit_wall(facing, &[((x, z), fitting)]);
            }
        }
        corridor.fit_wall(
            Facing::PlusX,
            &[
                ((-HALF_LENGTH, 0.15), Fitting::Sideboard),
                ((-HALF_LENGTH, -0.05), Fitting::Picture(Motif::Landscape)),
                ((-HALF_LENGTH, -0.75), Fitting::Pier(0.25, 0.25)),
            ],
        );
        corridor.fit_wall(
            Facing::MinusX,
            &[
                ((HALF_LENGTH, -0.5), Fitting::Chest),
                ((HALF_LENGTH, -0.45), Fitting::Picture(Motif::Flowers)),
                ((HALF_LENGTH, 0.25), Fitting::Pier(0.35, 0.4)),
                ((HALF_LENGTH, 0.75), Fitting::FloorLamp),
            ],
        );
        corridor.runners();

        let warm = Vec3::new(1.0, 0.9, 0.76);
        let lamps = [-12.8, -7.2, -1.6, 4.0, 9.4, 13.4].map(|x| {
            corridor.ceiling_lamp(x, 0.0);
            Lamp { position: Vec3::new(x, -2.3, 0.0), power: warm * 1.5 }
        });
        corridor.into_scene(lamps.to_vec())
    }
}

impl Builder {
    /// Carpets along the middle of the corridor, and things that lie about on them.
    fn runners(&mut self) {
        let palettes = [
            [0x9c3b34, 0x27344d, 0xe3c58f],
            [0x31506b, 0x8c3b2e, 0xd9c79a],
            [0x3f5d48, 0xd8b46a, 0x7a3b4a],
            [0x6a4a6f, 0xd9cdb0, 0x2f5d62],
        ];
        for (i, (x, half_length)) in
            [(-12.6, 1.3), (-9.1, 1.0), (-5.2, 1.6), (-0.6, 1.2), (3.3, 1.5), (7.3, 0.9), (11.2, 1.7)]
                .into_iter()
                .enumerate()
        {
            let half = Vec2::new(half_length, 0.42 + 0.04 * (i % 3) as f32);
            let colours = palettes[i % palettes.len()].map(colour);
            self.block((x, 0.0), 0.0, (2.0 * half.x, 0.015, 2.0 * half.y), Texture::Rug { half, colours }.into());
        }
        for (x, z, tall) in
            [(-10.9, 0.45, 0.22), (-4.1, -0.5, 0.3), (1.7, 0.5, 0.18), (6.1, -0.45, 0.26), (10.2, 0.5, 0.2)]
        {
            let turned = self.between(-0.8, 0.8);
            self.put((0.0, 0.0), (x, z), turned, |b| {
                b.soft((0.0, 0.0), 0.0, (0.34, tall, 0.24), 0.01, plain(0xc8a06b));
            });
        }
    }
}
