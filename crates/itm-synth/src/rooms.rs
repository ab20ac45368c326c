//! Ten rooms that are mistaken for each other.

use glam::{Quat, Vec2, Vec3};

use crate::fittings::{Facing, Fitting};
use crate::furniture::{Builder, cloth, oak, plain, walnut};
use crate::texture::colour;
use crate::{Lamp, Material, Motif, Object, Scene, Shape, Texture};

/// Number of rooms.
pub(crate) const ROOMS: usize = 10;
/// From one room's middle to the next one's, in metres.
pub(crate) const PITCH_M: f32 = 3.625;

/// Half of the rooms' inner side along z.
const HALF_DEPTH: f32 = 1.75;
const HEIGHT: f32 = 2.6;
const WALL_M: f32 = 0.2;
/// Middle and half width along z of the openings between rooms, and their height.
const OPENING_Z: f32 = -0.6;
const OPENING_HALF: f32 = 0.6;
const OPENING_HEIGHT: f32 = 2.1;
/// Where the object stands that tells a room from the others, from the room's middle, and on what height.
const OBJECT_AT: (f32, f32) = (-0.75, 1.4);
const OBJECT_ON: f32 = 0.5;

impl Scene {
    /// Ten rooms of 3.4 x 3.5 x 2.6 m in a row along x, open to each other, with the same walls, furniture and patterns:
    /// what one sees in one room is seen in each, but for one object on a chest before the wall at +z. A trap for
    /// whatever takes a place for another that looks the same.
    ///
    /// The world's origin lies on the floor in the middle of the row, y points down; the middle of room `i` of 0 to 9 is
    /// at x = 3.625 (i - 4.5). The first and the last room have a closed door where the others have an opening.
    pub fn rooms() -> Self {
        let mut rooms = Builder::new((ROOMS as f32 * PITCH_M, 2.0 * HALF_DEPTH), HEIGHT);
        rooms.repeat(ROOMS, PITCH_M, Builder::one_room);
        rooms.repeat(ROOMS + 1, PITCH_M, Builder::partition);
        let end = 0.5 * ROOMS as f32 * PITCH_M;
        let boards: Material = Texture::Planks { light: colour(0xb5713a), dark: colour(0x70401d), width: 0.12 }.into();
        for x in [-end - 0.5 * WALL_M, end + 0.5 * WALL_M] {
            rooms.block((x, OPENING_Z), 0.0, (WALL_M, HEIGHT, 2.0 * OPENING_HALF + 0.2), boards);
        }
        for i in 0..ROOMS {
            rooms.put((0.0, 0.0), (room_middle(i), 0.0), 0.0, |b| b.distinguish(i));
        }
        let lamps = (0..ROOMS)
            .map(|i| Lamp { position: Vec3::new(room_middle(i), -2.3, 0.2), power: Vec3::new(1.0, 0.9, 0.76) * 1.5 });
        rooms.into_scene(lamps.collect())
    }
}

/// Where the middle of a room is along x, in metres.
pub(crate) fn room_middle(room: usize) -> f32 {
    PITCH_M * (room as f32 - 0.5 * (ROOMS as f32 - 1.0))
}

impl Builder {
    /// A wall across x = 0 with an opening.
    fn partition(&mut self) {
        let material: Material =
            Texture::Bricks { brick: colour(0xa9573f), mortar: colour(0xb9ad9c), length: 0.25 }.into();
        let (left, right) = (OPENING_Z - OPENING_HALF, OPENING_Z + OPENING_HALF);
        for (from, to, bottom) in [(-HALF_DEPTH, left, 0.0), (right, HALF_DEPTH, 0.0), (left, right, OPENING_HEIGHT)] {
            self.block((0.0, 0.5 * (from + to)), bottom, (WALL_M, HEIGHT - bottom, to - from), material);
        }
        for z in [left, right] {
            self.block((0.0, z), 0.0, (WALL_M + 0.06, OPENING_HEIGHT, 0.08), walnut());
        }
        self.block((0.0, OPENING_Z), OPENING_HEIGHT, (WALL_M + 0.06, 0.08, 2.0 * OPENING_HALF + 0.08), walnut());
    }

    /// A room around x = 0, without the partitions at its ends.
    fn one_room(&mut self) {
        let (t, z) = (WALL_M, HALF_DEPTH);
        let floor = Texture::Planks { light: colour(0xc8935a), dark: colour(0x8f5c32), width: 0.14 };
        self.block((0.0, 0.0), -t, (PITCH_M, t, 2.0 * z + 2.0 * t), floor.into());
        let limed = Texture::Noise { a: colour(0xd9d4c8), b: colour(0xf2efe8), size: 0.35 };
        self.block((0.0, 0.0), HEIGHT, (PITCH_M, t, 2.0 * z + 2.0 * t), limed.into());
        let papered = Texture::Wallpaper { ground: colour(0xa9c2b4), flower: colour(0xd98a7b), size: 0.26 };
        self.block((0.0, z + 0.5 * t), 0.0, (PITCH_M, HEIGHT, t), papered.into());
        let painted = Texture::Noise { a: colour(0xd7b98a), b: colour(0xe9d6b2), size: 0.5 };
        self.block((0.0, -z - 0.5 * t), 0.0, (PITCH_M, HEIGHT, t), painted.into());
        self.block((0.0, 0.2), HEIGHT - 0.14, (0.14, 0.14, 2.0 * z), walnut());

        self.ceiling_lamp(0.0, 0.2);
        let inner = 0.5 * (PITCH_M - t);
        self.fit_wall(
            Facing::MinusZ,
            &[((0.7, z), Fitting::Bookshelf), ((-0.8, z), Fitting::Picture(Motif::Landscape))],
        );
        self.fit_wall(
            Facing::PlusZ,
            &[((0.95, -z), Fitting::Chest), ((0.9, -z), Fitting::WallShelf), ((-0.3, -z), Fitting::Pier(0.3, 0.2))],
        );
        self.fit_wall(
            Facing::PlusX,
            &[((-inner, 0.9), Fitting::Picture(Motif::Flowers)), ((-inner, 0.5), Fitting::Chair)],
        );
        self.fit_wall(Facing::MinusX, &[((inner, 0.75), Fitting::WallShelf), ((inner, 0.7), Fitting::Boxes(3))]);
        let (x, at_z) = OBJECT_AT;
        self.soft((x, at_z), 0.0, (0.9, OBJECT_ON, 0.5), 0.02, cloth(0x5b7d87, 0x9fbcc0, 0.1));
        let half = Vec2::new(0.9, 0.6);
        let colours = [colour(0x9c3b34), colour(0x27344d), colour(0xe3c58f)];
        self.block((0.0, 0.45), 0.0, (2.0 * half.x, 0.015, 2.0 * half.y), Texture::Rug { half, colours }.into());
        self.soft((0.35, 0.55), 0.0, (0.7, 0.4, 0.45), 0.03, oak());
        self.lying_books((0.25, 0.55), 0.4, 3);
        self.mug((0.55, 0.5), 0.4, 0x3f7cac);
    }

    /// The object that only room `i` has, before the room's middle is put in its place.
    fn distinguish(&mut self, room: usize) {
        let (x, z) = OBJECT_AT;
        let bottom = OBJECT_ON;
        let one = |shape: Shape, up: f32, c: u32| Object::new(shape, cloth(c, 0xf2e9d8, 0.08)).at(x, -bottom - up, z);
        match room {
            0 => self.vase((x, z), bottom, 0.45, 0x2d7f8a),
            1 => self.add(one(Shape::Sphere { radius: 0.2 }, 0.2, 0xd7263d)),
            2 => self.add(one(Shape::rounded(0.5, 0.35, 0.3, 0.02), 0.175, 0x7b5ea7)),
            3 => self.add(one(Shape::Cone { top: 0.05, bottom: 0.2, half_height: 0.25 }, 0.25, 0xe07a1f)),
            4 => self.add(one(Shape::cylinder(0.12, 0.55), 0.275, 0x2a6f97)),
            5 => self.lying_books((x, z), bottom, 8),
            6 => self.add(
                one(Shape::Torus { major: 0.18, minor: 0.06 }, 0.24, 0x386641)
                    .turned(Quat::from_rotation_x(std::f32::consts::FRAC_PI_2)),
            ),
            7 => {
                let face = Material { grain: 0.05, ..Texture::Clock { radius: 0.2 }.into() };
                self.block((x, z), bottom, (0.46, 0.5, 0.12), walnut());
                self.add(
                    Object::new(Shape::cylinder(0.2, 0.16), face)
                        .at(x, -bottom - 0.25, z)
                        .turned(Quat::from_rotation_x(std::f32::consts::FRAC_PI_2)),
                );
            }
            8 => self.bowl_of_fruit((x, z), bottom),
            _ => {
                self.post((x, z), bottom, 0.05, 0.3, plain(0xd8b46a));
                self.add(one(Shape::Capsule { radius: 0.12, half_height: 0.1 }, 0.45, 0xc9623f));
            }
        }
    }
}
