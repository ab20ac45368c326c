//! Furniture, described as it stands in [`Scene::room`](crate::Scene::room); [`Builder::put`] moves it elsewhere.

use std::f32::consts::{FRAC_PI_2, PI, TAU};

use glam::{Quat, Vec2, Vec3};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg32;

use crate::texture::colour;
use crate::{Bounds, Lamp, Material, Motif, Object, Scene, Shape, Texture};

/// Where the room's walls and its ceiling are: pieces are described against them.
const HALF_X: f32 = 2.5;
const HALF_Z: f32 = 2.0;
const HEIGHT: f32 = 2.6;

/// Thickness of walls, floor and ceiling in metres.
const WALL_M: f32 = 0.2;

/// Makes the objects of a scene: a box-shaped hull around the origin, and what stands in it.
pub(crate) struct Builder {
    objects: Vec<Object>,
    /// Varies books, leaves and patterns; always seeded alike, so that there is one of each scene.
    random: Pcg32,
    /// Half of the inner sides along x and z, and the height, in metres.
    half_x: f32,
    half_z: f32,
    height: f32,
}

/// What floor, ceiling and walls look like.
pub(crate) struct Surfaces {
    pub(crate) floor: Material,
    pub(crate) ceiling: Material,
    /// Walls at +z, -z, +x, -x.
    pub(crate) walls: [Material; 4],
}

pub(crate) fn wood(light: u32, dark: u32) -> Material {
    Texture::Wood { light: colour(light), dark: colour(dark) }.into()
}

pub(crate) fn cloth(a: u32, b: u32, size: f32) -> Material {
    Material { grain: 0.45, ..Texture::Noise { a: colour(a), b: colour(b), size }.into() }
}

pub(crate) fn plain(c: u32) -> Material {
    Texture::Plain(colour(c)).into()
}

pub(crate) fn oak() -> Material {
    wood(0xc99a5f, 0x8a5a2b)
}

pub(crate) fn walnut() -> Material {
    wood(0x8a5c3b, 0x4a2c1a)
}

impl Builder {
    /// An empty space of so many metres along x, z and upwards.
    pub(crate) fn new((x, z): (f32, f32), height: f32) -> Self {
        let random = Pcg32::seed_from_u64(1);
        Self { objects: Vec::new(), random, half_x: 0.5 * x, half_z: 0.5 * z, height }
    }

    pub(crate) fn into_scene(self, lamps: Vec<Lamp>) -> Scene {
        let Self { half_x, half_z, height, objects, .. } = self;
        let bounds = Bounds::new(Vec3::new(-half_x, -height, -half_z), Vec3::new(half_x, 0.0, half_z));
        Scene::new(objects, bounds).with_lamps(lamps)
    }

    /// Adds pieces that stand in the room, turned about the vertical by `turn` (from +x towards -z), so that the place
    /// `from` on the room's floor comes to lie at `to`.
    pub(crate) fn put(&mut self, from: (f32, f32), to: (f32, f32), turn: f32, pieces: impl FnOnce(&mut Self)) {
        let first = self.objects.len();
        pieces(self);
        let on_floor = |(x, z): (f32, f32)| Vec3::new(x, 0.0, z);
        for object in &mut self.objects[first..] {
            *object = object.moved(on_floor(from), on_floor(to), Quat::from_rotation_y(turn));
        }
    }

    /// Adds pieces `count` times, `pitch_m` apart along x, around the place where they are described. They look alike to
    /// the last book and the last grain.
    pub(crate) fn repeat(&mut self, count: usize, pitch_m: f32, pieces: impl FnOnce(&mut Self)) {
        let first = self.objects.len();
        pieces(self);
        for object in self.objects.split_off(first) {
            self.objects.extend((0..count).map(|i| {
                let to = Vec3::X * pitch_m * (i as f32 - 0.5 * (count as f32 - 1.0));
                object.moved(Vec3::ZERO, to, Quat::IDENTITY)
            }));
        }
    }

    /// Height of the ceiling in metres.
    pub(crate) fn height(&self) -> f32 {
        self.height
    }

    /// Floor, walls, ceiling with beams across z at some x, skirting.
    pub(crate) fn shell(&mut self, surfaces: &Surfaces, beams: &[f32]) {
        let Self { half_x, half_z, height, .. } = *self;
        let t = WALL_M;
        let (x, z) = (2.0 * half_x + 2.0 * t, 2.0 * half_z + 2.0 * t);
        self.block((0.0, 0.0), -t, (x, t, z), surfaces.floor);
        self.block((0.0, 0.0), height, (x, t, z), surfaces.ceiling);
        let [far, near, right, left] = surfaces.walls;
        self.block((0.0, half_z + 0.5 * t), 0.0, (x, height, t), far);
        self.block((0.0, -half_z - 0.5 * t), 0.0, (x, height, t), near);
        self.block((half_x + 0.5 * t, 0.0), 0.0, (t, height, z), right);
        self.block((-half_x - 0.5 * t, 0.0), 0.0, (t, height, z), left);

        for &x in beams {
            self.objects.push(
                Object::new(Shape::cuboid(2.0 * half_z, 0.14, 0.12), walnut())
                    .at(x, -height + 0.07, 0.0)
                    .turned(Quat::from_rotation_y(FRAC_PI_2)),
            );
        }
        let skirting = plain(0xefe9dc);
        for z in [-half_z + 0.012, half_z - 0.012] {
            self.block((0.0, z), 0.0, (2.0 * half_x, 0.1, 0.024), skirting);
        }
        for x in [-half_x + 0.012, half_x - 0.012] {
            self.block((x, 0.0), 0.0, (0.024, 0.1, 2.0 * half_z), skirting);
        }
    }

    /// A round lamp under a beam.
    pub(crate) fn ceiling_lamp(&mut self, x: f32, z: f32) {
        let glass = Material { glow: 0.9, grain: 0.0, ..plain(0xfff3dc) };
        let ring = Object::new(Shape::Torus { major: 0.19, minor: 0.03 }, plain(0xb08d57));
        let shade = Object::new(Shape::Cylinder { radius: 0.18, half_height: 0.05, rounding: 0.045 }, glass);
        let above_room = self.height - HEIGHT;
        self.add(ring.at(x, -2.43 - above_room, z));
        self.add(shade.at(x, -2.42 - above_room, z));
    }

    pub(crate) fn add(&mut self, object: Object) {
        let seed = self.random.next_u32();
        self.objects.push(object.seeded(seed));
    }

    pub(crate) fn between(&mut self, lo: f32, hi: f32) -> f32 {
        self.random.random_range(lo..hi)
    }

    pub(crate) fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.random.random_range(0..from.len())]
    }

    /// A box from its centre's x and z, its bottom's height above the floor, and its sides.
    pub(crate) fn block(&mut self, (x, z): (f32, f32), bottom: f32, (sx, sy, sz): (f32, f32, f32), material: Material) {
        self.add(Object::new(Shape::cuboid(sx, sy, sz), material).at(x, -bottom - 0.5 * sy, z));
    }

    /// The same with rounded edges.
    pub(crate) fn soft(
        &mut self,
        (x, z): (f32, f32),
        bottom: f32,
        (sx, sy, sz): (f32, f32, f32),
        rounding: f32,
        material: Material,
    ) {
        self.add(Object::new(Shape::rounded(sx, sy, sz, rounding), material).at(x, -bottom - 0.5 * sy, z));
    }

    /// An upright cylinder from its centre's x and z, its bottom's height above the floor, radius and height.
    pub(crate) fn post(&mut self, (x, z): (f32, f32), bottom: f32, radius: f32, height: f32, material: Material) {
        self.add(Object::new(Shape::cylinder(radius, height), material).at(x, -bottom - 0.5 * height, z));
    }

    /// A window with curtains and a radiator in the wall at +x.
    pub(crate) fn window(&mut self) {
        let (x, z, sill) = (HALF_X, 0.35, 0.95);
        let outside = Texture::Picture { half: Vec2::new(0.65, 0.6), motif: Motif::Outside };
        let view = Material { glow: 0.35, grain: 0.05, texture: outside };
        self.block((x, z), sill, (0.03, 1.2, 1.3), view);
        let white = plain(0xf4f1ea);
        for (dz, wide) in [(-0.65, 0.07), (0.0, 0.06), (0.65, 0.07)] {
            self.block((x - 0.02, z + dz), sill, (0.07, 1.2, wide), white);
        }
        for (h, tall) in [(0.0, 0.07), (0.75, 0.04), (1.15, 0.07)] {
            self.block((x - 0.02, z), sill + h, (0.06, tall, 1.37), white);
        }
        self.block((x - 0.1, z), sill - 0.04, (0.24, 0.04, 1.5), oak());
        for i in 0..11 {
            let at = z - 0.55 + 0.11 * i as f32;
            self.add(Object::new(Shape::Capsule { radius: 0.035, half_height: 0.24 }, plain(0xe6e2d6)).at(
                x - 0.1,
                -0.45,
                at,
            ));
        }
        for h in [0.24, 0.66] {
            self.block((x - 0.1, z), h - 0.02, (0.04, 0.04, 1.2), plain(0xd8d3c6));
        }
        let curtain: Material = Texture::Stripes { a: colour(0xa6433c), b: colour(0xd9a441), size: 0.055 }.into();
        for side in [-1.0, 1.0] {
            for i in 0..5 {
                let radius = self.between(0.034, 0.05);
                let at = z + side * (0.72 + 0.072 * i as f32);
                self.add(Object::new(Shape::Capsule { radius, half_height: 0.97 }, curtain).at(
                    x - 0.14 + 0.02 * (i % 2) as f32,
                    -1.25,
                    at,
                ));
            }
        }
        self.add(
            Object::new(Shape::Capsule { radius: 0.016, half_height: 1.15 }, plain(0x3a3632))
                .at(x - 0.14, -2.27, z)
                .turned(Quat::from_rotation_x(FRAC_PI_2)),
        );
        // On the sill.
        self.pot((x - 0.11, z - 0.35), sill, 0.06, 0.11, 0xb5532d);
        for i in 0..9 {
            let turn = i as f32 * 2.4;
            let lean = Quat::from_rotation_y(turn) * Quat::from_rotation_x(0.35 + 0.06 * i as f32);
            let leaf = Shape::rounded(0.035, 0.2, 0.014, 0.007);
            let up = lean * Vec3::new(0.0, -0.1, 0.0);
            let at = Vec3::new(x - 0.11, -sill - 0.1, z - 0.35) + up;
            self.add(Object::new(leaf, cloth(0x2f6b36, 0x6fae4e, 0.05)).at(at.x, at.y, at.z).turned(lean));
        }
        self.add(Object::new(Shape::Sphere { radius: 0.06 }, plain(0x2b7a9b)).at(x - 0.12, -sill - 0.06, z + 0.3));
    }

    /// A door in the wall at -z.
    pub(crate) fn door(&mut self) {
        let (x, z) = (-1.75, -HALF_Z);
        let frame = plain(0xf1ede2);
        for dx in [-0.46, 0.46] {
            self.block((x + dx, z + 0.02), 0.0, (0.08, 2.08, 0.08), frame);
        }
        self.block((x, z + 0.02), 2.02, (1.0, 0.08, 0.08), frame);
        let leaf = wood(0xb98550, 0x7d4f29);
        self.block((x, z + 0.01), 0.0, (0.86, 2.02, 0.04), leaf);
        for (h, tall) in [(0.16, 0.72), (1.0, 0.86)] {
            for dx in [-0.2, 0.2] {
                self.soft((x + dx, z + 0.03), h, (0.28, tall, 0.035), 0.012, leaf);
            }
        }
        let brass = plain(0xc9a24a);
        self.add(
            Object::new(Shape::Capsule { radius: 0.012, half_height: 0.055 }, brass)
                .at(x + 0.33, -1.04, z + 0.085)
                .turned(Quat::from_rotation_z(FRAC_PI_2)),
        );
        self.block((x + 0.38, z + 0.03), 0.95, (0.04, 0.2, 0.03), brass);
        self.block((x + 0.38, z + 0.06), 1.03, (0.02, 0.02, 0.06), brass);
        // A coat hook rail beside it, with a hat and a bag.
        self.block((x + 0.98, z + 0.015), 1.62, (0.6, 0.08, 0.03), walnut());
        for i in 0..4 {
            let at = x + 0.76 + 0.15 * i as f32;
            self.add(Object::new(Shape::Sphere { radius: 0.022 }, brass).at(at, -1.66, z + 0.055));
        }
        self.soft((x + 0.84, z + 0.09), 1.12, (0.3, 0.36, 0.12), 0.05, cloth(0x2f5d62, 0x77a6a0, 0.06));
        self.add(
            Object::new(Shape::Torus { major: 0.12, minor: 0.012 }, plain(0x3f2f22))
                .at(x + 0.84, -1.53, z + 0.07)
                .turned(Quat::from_rotation_x(FRAC_PI_2)),
        );
        let felt = cloth(0x9c7b4f, 0xd0b07c, 0.04);
        let tilt = Quat::from_rotation_x(-1.25);
        self.add(Object::new(Shape::cylinder(0.17, 0.012), felt).at(x + 1.21, -1.6, z + 0.09).turned(tilt));
        self.add(
            Object::new(Shape::Cylinder { radius: 0.1, half_height: 0.06, rounding: 0.03 }, felt)
                .at(x + 1.21, -1.58, z + 0.14)
                .turned(tilt),
        );
    }

    /// A sofa along the wall at +z, with cushions, and a side table.
    pub(crate) fn sofa(&mut self) {
        let (x, z) = (0.1, 1.5);
        let body = cloth(0x2d6a72, 0x6fb0ab, 0.12);
        let seat = cloth(0x3d858a, 0x8cc7be, 0.1);
        self.soft((x, z), 0.1, (2.1, 0.26, 0.84), 0.04, body);
        self.soft((x, z + 0.32), 0.15, (2.1, 0.72, 0.22), 0.09, body);
        for side in [-1.0, 1.0] {
            self.soft((x + side * 1.0, z), 0.1, (0.2, 0.54, 0.86), 0.08, body);
            self.soft((x + side * 0.45, z - 0.06), 0.34, (0.88, 0.16, 0.66), 0.06, seat);
            self.add(
                Object::new(Shape::rounded(0.86, 0.42, 0.18, 0.08), seat)
                    .at(x + side * 0.45, -0.68, z + 0.16)
                    .turned(Quat::from_rotation_x(0.2)),
            );
            for dz in [-0.33, 0.33] {
                self.post((x + side * 0.95, z + dz), 0.0, 0.03, 0.11, walnut());
            }
        }
        let checked: Material = Texture::Checker { a: colour(0xe8c547), b: colour(0x9e3d2f), size: 0.07 }.into();
        let flowered: Material =
            Texture::Wallpaper { ground: colour(0xf2e9d8), flower: colour(0x3c6fa8), size: 0.13 }.into();
        let striped: Material = Texture::Stripes { a: colour(0xf0ead8), b: colour(0xcf5b3c), size: 0.06 }.into();
        for (dx, lean, roll, material) in
            [(-0.72, 0.35, 0.25, checked), (-0.34, 0.45, -0.2, flowered), (0.7, 0.4, 0.5, striped)]
        {
            self.add(
                Object::new(Shape::rounded(0.42, 0.42, 0.14, 0.065), material)
                    .at(x + dx, -0.69, z - 0.02)
                    .turned(Quat::from_rotation_x(lean) * Quat::from_rotation_z(roll)),
            );
        }
        // A blanket over the arm.
        let blanket: Material = Texture::Checker { a: colour(0xb7c9a8), b: colour(0x4f6d4a), size: 0.05 }.into();
        self.soft((x + 1.0, z - 0.1), 0.3, (0.25, 0.37, 0.4), 0.09, blanket);

        // A side table with books and a mug.
        self.post((-1.28, 1.6), 0.0, 0.16, 0.02, plain(0x2f2b28));
        self.post((-1.28, 1.6), 0.0, 0.025, 0.52, plain(0x2f2b28));
        self.post((-1.28, 1.6), 0.52, 0.24, 0.03, oak());
        self.lying_books((-1.32, 1.62), 0.55, 3);
        self.mug((-1.16, 1.5), 0.55, 0xd8553f);
    }

    pub(crate) fn coffee_table(&mut self) {
        let half = Vec2::new(1.05, 0.75);
        let colours = [colour(0x9c3b34), colour(0x27344d), colour(0xe3c58f)];
        let rug = Material { grain: 0.35, ..Texture::Rug { half, colours }.into() };
        self.block((0.05, 0.15), 0.0, (2.0 * half.x, 0.015, 2.0 * half.y), rug);
        let (x, z) = (0.05, 0.3);
        self.soft((x, z), 0.38, (1.0, 0.045, 0.55), 0.015, oak());
        self.block((x, z), 0.15, (0.86, 0.025, 0.42), oak());
        for (dx, dz) in [(-0.42, -0.21), (0.42, -0.21), (-0.42, 0.21), (0.42, 0.21)] {
            self.block((x + dx, z + dz), 0.0, (0.05, 0.38, 0.05), oak());
        }
        self.lying_books((x - 0.28, z), 0.425, 2);
        self.mug((x + 0.1, z - 0.13), 0.425, 0x3f7cac);
        self.bowl_of_fruit((x + 0.24, z + 0.08), 0.425);
        self.lying_books((x + 0.15, z), 0.175, 3);
        // A pouf.
        let knit: Material =
            Texture::Sectors { colours: [colour(0xd9a05b), colour(0xc07a3e), colour(0xe8c08a)], count: 24 }.into();
        self.add(
            Object::new(Shape::Cylinder { radius: 0.27, half_height: 0.19, rounding: 0.14 }, knit)
                .at(-0.95, -0.19, 0.55),
        );
    }

    /// A bookshelf along the wall at -x, full of books and small things.
    pub(crate) fn bookshelf(&mut self) {
        let (depth, width, height) = (0.3, 1.9, 2.05);
        let (x, z) = (-HALF_X + 0.5 * depth, -0.1);
        let board = wood(0xd8b384, 0xa87b4c);
        self.block((-HALF_X + 0.01, z), 0.0, (0.02, height, width), wood(0x9c7650, 0x6d4e32));
        for i in 0..=3 {
            let at = z - 0.5 * width + i as f32 * width / 3.0;
            self.block((x, at), 0.0, (depth, height, 0.03), board);
        }
        let levels = [0.06, 0.45, 0.83, 1.19, 1.55, 2.02];
        for level in levels {
            self.block((x, z), level, (depth, 0.03, width), board);
        }
        for (row, pair) in levels.windows(2).enumerate() {
            let (floor, room) = (pair[0] + 0.03, pair[1] - pair[0] - 0.03);
            for column in 0..3 {
                let from = z - 0.5 * width + column as f32 * width / 3.0 + 0.02;
                let to = from + width / 3.0 - 0.04;
                match (row, column) {
                    (1, 1) => {
                        self.lying_books((x + 0.02, from + 0.2), floor, 5);
                        self.vase((x + 0.02, to - 0.12), floor, 0.2, 0x2d7f8a);
                    }
                    (2, 0) => {
                        self.globe((x + 0.02, 0.5 * (from + to) - 0.1), floor);
                        self.books(x, to - 0.2, to, floor, room);
                    }
                    (3, 2) => {
                        self.photo((x + 0.02, from + 0.17), floor, Motif::Flowers);
                        self.vase((x, to - 0.15), floor, 0.22, 0xc9623f);
                    }
                    (0, 2) => {
                        let wicker: Material =
                            Texture::Checker { a: colour(0xc79a5b), b: colour(0x8f6633), size: 0.03 }.into();
                        self.soft((x + 0.02, 0.5 * (from + to)), floor, (0.25, 0.24, 0.46), 0.03, wicker);
                    }
                    _ => self.books(x, from, to, floor, room),
                }
            }
        }
        // On top.
        self.soft((x, z - 0.6), height, (0.26, 0.18, 0.4), 0.02, cloth(0x7b5ea7, 0xb79fd6, 0.08));
        self.vase((x, z + 0.65), height, 0.26, 0x35507c);
        self.add(Object::new(Shape::Sphere { radius: 0.11 }, plain(0xd0a12e)).at(x, -height - 0.11, z));
    }

    /// Books standing in a row along z, their backs towards +x.
    pub(crate) fn books(&mut self, x: f32, from: f32, to: f32, floor: f32, room: f32) {
        const COVERS: [u32; 12] = [
            0x8c2f39, 0x274c77, 0x386641, 0xbc6c25, 0x5e548e, 0xe0a458, 0x2b2d42, 0xa3b18a, 0xd62828, 0x1d7874,
            0xede0d4, 0x6d597a,
        ];
        let mut at = from;
        loop {
            let thick = self.between(0.018, 0.05);
            if at + thick > to {
                return;
            }
            let tall = self.between(0.62, 0.92) * room.min(0.34);
            let deep = self.between(0.15, 0.24);
            let cover = colour(self.pick(&COVERS));
            let band = colour(self.pick(&[0xe8d9a0, 0xf5f0e6, 0x20201e, 0xd4af37]));
            let book = Material { grain: 0.12, ..Texture::Book { cover, band, half_height: 0.5 * tall }.into() };
            // Some lean on their neighbour.
            let lean = if self.between(0.0, 1.0) < 0.12 { self.between(0.02, 0.05) } else { 0.0 };
            self.add(
                Object::new(Shape::Box { half: 0.5 * Vec3::new(deep, tall, thick), rounding: 0.003 }, book)
                    .at(x - 0.14 + 0.5 * deep + 0.02, -floor - 0.5 * tall, at + 0.5 * thick)
                    .turned(Quat::from_rotation_x(lean)),
            );
            at += thick + 0.002;
            if self.between(0.0, 1.0) < 0.07 {
                at += self.between(0.03, 0.1);
            }
        }
    }

    pub(crate) fn lying_books(&mut self, (x, z): (f32, f32), floor: f32, count: usize) {
        let mut bottom = floor;
        for _ in 0..count {
            let thick = self.between(0.02, 0.045);
            let (long, wide) = (self.between(0.2, 0.27), self.between(0.14, 0.19));
            let cover = colour(self.pick(&[0xb23a48, 0x2a6f97, 0xe9c46a, 0x606c38, 0x7f4f24, 0xe5e0d8]));
            let book = Texture::Picture { half: Vec2::new(0.5 * wide, 0.5 * long), motif: Motif::Abstract };
            let material: Material =
                if self.between(0.0, 1.0) < 0.4 { book.into() } else { Texture::Plain(cover).into() };
            let turn = self.between(-0.4, 0.4);
            self.add(
                Object::new(Shape::rounded(wide, thick, long, 0.003), material)
                    .at(x, -bottom - 0.5 * thick, z)
                    .turned(Quat::from_rotation_y(turn)),
            );
            bottom += thick;
        }
    }

    pub(crate) fn mug(&mut self, (x, z): (f32, f32), floor: f32, c: u32) {
        let glaze: Material = Texture::Checker { a: colour(c), b: colour(0xf4efe6), size: 0.024 }.into();
        self.post((x, z), floor, 0.04, 0.095, glaze);
        self.add(
            Object::new(Shape::Torus { major: 0.03, minor: 0.007 }, plain(c))
                .at(x + 0.042, -floor - 0.05, z)
                .turned(Quat::from_rotation_x(FRAC_PI_2)),
        );
    }

    pub(crate) fn vase(&mut self, (x, z): (f32, f32), floor: f32, tall: f32, c: u32) {
        let glaze: Material = Texture::Wallpaper { ground: colour(c), flower: colour(0xf3e3c3), size: 0.06 }.into();
        let belly = 0.36 * tall;
        self.add(
            Object::new(Shape::Cylinder { radius: belly, half_height: 0.33 * tall, rounding: 0.3 * tall }, glaze).at(
                x,
                -floor - 0.33 * tall,
                z,
            ),
        );
        self.add(
            Object::new(Shape::Cone { top: 0.22 * tall, bottom: 0.12 * tall, half_height: 0.2 * tall }, glaze).at(
                x,
                -floor - 0.8 * tall,
                z,
            ),
        );
    }

    pub(crate) fn pot(&mut self, (x, z): (f32, f32), floor: f32, radius: f32, tall: f32, c: u32) {
        let clay = cloth(c, 0xd98f5f, 0.07);
        self.add(Object::new(Shape::Cone { top: radius, bottom: 0.7 * radius, half_height: 0.5 * tall }, clay).at(
            x,
            -floor - 0.5 * tall,
            z,
        ));
        self.add(Object::new(Shape::Torus { major: radius, minor: 0.12 * radius }, clay).at(
            x,
            -floor - 0.95 * tall,
            z,
        ));
    }

    pub(crate) fn globe(&mut self, (x, z): (f32, f32), floor: f32) {
        let map: Material = Texture::Noise { a: colour(0x2b6cb0), b: colour(0x8fae4e), size: 0.07 }.into();
        self.post((x, z), floor, 0.07, 0.02, walnut());
        self.post((x, z), floor, 0.012, 0.08, walnut());
        self.add(Object::new(Shape::Sphere { radius: 0.095 }, map).at(x, -floor - 0.165, z));
        self.add(
            Object::new(Shape::Torus { major: 0.105, minor: 0.006 }, plain(0xc9a24a))
                .at(x, -floor - 0.165, z)
                .turned(Quat::from_rotation_x(1.2)),
        );
    }

    /// A framed photograph standing up, facing +x.
    pub(crate) fn photo(&mut self, (x, z): (f32, f32), floor: f32, motif: Motif) {
        self.block((x, z), floor, (0.02, 0.24, 0.19), walnut());
        let print = Texture::Picture { half: Vec2::new(0.075, 0.1), motif };
        self.block((x + 0.006, z), floor + 0.02, (0.02, 0.2, 0.15), print.into());
    }

    pub(crate) fn bowl_of_fruit(&mut self, (x, z): (f32, f32), floor: f32) {
        let glaze: Material =
            Texture::Sectors { colours: [colour(0xf1ead9), colour(0x3f6c8f), colour(0xf1ead9)], count: 18 }.into();
        self.add(Object::new(Shape::Cone { top: 0.13, bottom: 0.06, half_height: 0.03 }, glaze).at(
            x,
            -floor - 0.03,
            z,
        ));
        self.add(Object::new(Shape::Torus { major: 0.125, minor: 0.012 }, glaze).at(x, -floor - 0.06, z));
        for (i, c) in [0xd1372c, 0xf0a020, 0x8fb339, 0xe8632b].into_iter().enumerate() {
            let turn = i as f32 * FRAC_PI_2 + 0.4;
            let peel = cloth(c, c, 0.05);
            self.add(Object::new(Shape::Sphere { radius: 0.042 }, peel).at(
                x + 0.055 * turn.cos(),
                -floor - 0.085,
                z + 0.055 * turn.sin(),
            ));
        }
        self.add(Object::new(Shape::Sphere { radius: 0.042 }, cloth(0xf2c53d, 0xd98e1f, 0.04)).at(x, -floor - 0.14, z));
    }

    /// A table with chairs and a hanging lamp in the corner at +x, -z.
    pub(crate) fn dining_corner(&mut self) {
        let (x, z) = (1.55, -1.2);
        let top = wood(0xb5713a, 0x70401d);
        self.add(Object::new(Shape::Cylinder { radius: 0.5, half_height: 0.02, rounding: 0.012 }, top).at(x, -0.74, z));
        self.add(Object::new(Shape::Cone { top: 0.05, bottom: 0.09, half_height: 0.34 }, top).at(x, -0.38, z));
        self.add(Object::new(Shape::Cone { top: 0.1, bottom: 0.3, half_height: 0.025 }, top).at(x, -0.025, z));
        for (turn, away) in [(2.55, 0.55), (-0.45, 0.58), (0.95, 0.62)] {
            self.chair(Vec3::new(x, 0.0, z), turn, away);
        }
        self.vase((x + 0.05, z + 0.02), 0.76, 0.22, 0xdfe7ea);
        for i in 0..7 {
            let lean = Quat::from_rotation_y(i as f32 * 2.4) * Quat::from_rotation_x(0.15 + 0.05 * i as f32);
            let tip = Vec3::new(x + 0.05, -0.9, z + 0.02) + lean * Vec3::new(0.0, -0.3, 0.0);
            let mid = Vec3::new(x + 0.05, -0.9, z + 0.02) + lean * Vec3::new(0.0, -0.15, 0.0);
            self.add(
                Object::new(Shape::Capsule { radius: 0.007, half_height: 0.15 }, plain(0x4c7a3a))
                    .at(mid.x, mid.y, mid.z)
                    .turned(lean),
            );
            let c = [0xe4572e, 0xf3a712, 0xd64b8a, 0xf7f0e0][i % 4];
            self.add(Object::new(Shape::Sphere { radius: 0.038 }, cloth(c, 0xf9d5c0, 0.04)).at(tip.x, tip.y, tip.z));
        }
        for (dx, dz, c) in [(-0.3, 0.1, 0x3d5a80), (0.12, -0.3, 0xee6c4d), (0.2, 0.3, 0x588157)] {
            let plate: Material =
                Texture::Sectors { colours: [colour(0xf4f1e8), colour(c), colour(0xf4f1e8)], count: 24 }.into();
            self.post((x + dx, z + dz), 0.76, 0.11, 0.018, plate);
            self.post((x + dx, z + dz), 0.765, 0.07, 0.018, plain(0xf7f4ec));
        }
        self.mug((x - 0.12, z + 0.3), 0.76, 0x6a994e);
        // The hanging lamp.
        let shade: Material =
            Material { glow: 0.35, ..Texture::Stripes { a: colour(0xe76f51), b: colour(0xf4a261), size: 0.06 }.into() };
        self.post((x, z), 1.85, 0.008, self.height - 1.85, plain(0x222222));
        self.add(Object::new(Shape::Cone { top: 0.07, bottom: 0.23, half_height: 0.11 }, shade).at(x, -1.76, z));
        let bulb = Material { glow: 1.0, grain: 0.0, ..plain(0xfff4d6) };
        self.add(Object::new(Shape::Sphere { radius: 0.06 }, bulb).at(x, -1.63, z));
    }

    /// A chair on the floor, `away` from a point, facing it, turned by `turn` about the vertical.
    pub(crate) fn chair(&mut self, towards: Vec3, turn: f32, away: f32) {
        let world_from_chair = Quat::from_rotation_y(turn);
        let frame = wood(0xd9a566, 0x9c6a34);
        let seat: Material = Texture::Checker { a: colour(0x4d7c8a), b: colour(0xcbdfbd), size: 0.05 }.into();
        // In the chair's coordinates the back is at +z and the table at -z.
        let part = |builder: &mut Self, shape: Shape, x: f32, height: f32, z: f32, material: Material| {
            let at = towards + world_from_chair * Vec3::new(x, -height, z + away);
            builder.add(Object::new(shape, material).at(at.x, at.y, at.z).turned(world_from_chair));
        };
        part(self, Shape::rounded(0.42, 0.035, 0.4, 0.012), 0.0, 0.45, 0.0, frame);
        part(self, Shape::rounded(0.38, 0.04, 0.36, 0.018), 0.0, 0.48, 0.0, seat);
        for dx in [-0.18, 0.18] {
            part(self, Shape::cylinder(0.018, 0.44), dx, 0.22, -0.17, frame);
            part(self, Shape::cylinder(0.018, 0.94), dx, 0.47, 0.18, frame);
        }
        for height in [0.62, 0.76, 0.9] {
            part(self, Shape::rounded(0.38, 0.06, 0.022, 0.01), 0.0, height, 0.18, frame);
        }
    }

    /// A low cupboard along the wall at -z, with a radio, a lamp and a plant.
    pub(crate) fn sideboard(&mut self) {
        let (x, z) = (-0.05, -HALF_Z + 0.21);
        let front = wood(0xc08a55, 0x86542a);
        self.block((x, z), 0.12, (1.5, 0.6, 0.42), walnut());
        for dx in [-0.65, 0.65] {
            for dz in [-0.15, 0.15] {
                self.post((x + dx, z + dz), 0.0, 0.022, 0.12, walnut());
            }
        }
        for i in 0..3 {
            let at = x - 0.49 + 0.49 * i as f32;
            self.soft((at, z + 0.21), 0.15, (0.46, 0.26, 0.03), 0.008, front);
            self.soft((at, z + 0.21), 0.43, (0.46, 0.26, 0.03), 0.008, front);
            for h in [0.28, 0.56] {
                self.add(Object::new(Shape::Sphere { radius: 0.016 }, plain(0xd4b25a)).at(at, -h, z + 0.24));
            }
        }
        // A radio.
        self.soft((x - 0.4, z), 0.72, (0.42, 0.22, 0.18), 0.03, wood(0xa15e2e, 0x66371a));
        let grille: Material = Texture::Stripes { a: colour(0x2b2622), b: colour(0xd9c9a3), size: 0.018 }.into();
        self.block((x - 0.48, z + 0.09), 0.76, (0.2, 0.14, 0.01), grille);
        for dx in [-0.28, -0.22] {
            self.add(
                Object::new(Shape::cylinder(0.022, 0.03), plain(0xe8dcc0))
                    .at(x + dx, -0.8, z + 0.1)
                    .turned(Quat::from_rotation_x(FRAC_PI_2)),
            );
        }
        // A table lamp.
        self.add(
            Object::new(
                Shape::Cylinder { radius: 0.08, half_height: 0.12, rounding: 0.07 },
                cloth(0x7a9e9f, 0xd5e0d4, 0.05),
            )
            .at(x + 0.05, -0.84, z),
        );
        let shade: Material =
            Material { glow: 0.3, ..Texture::Noise { a: colour(0xe9d8a6), b: colour(0xfaf3dd), size: 0.05 }.into() };
        self.add(Object::new(Shape::Cone { top: 0.1, bottom: 0.16, half_height: 0.1 }, shade).at(x + 0.05, -1.06, z));
        // A plant.
        self.pot((x + 0.52, z), 0.72, 0.09, 0.15, 0x3f5d7d);
        for i in 0..16 {
            let lean =
                Quat::from_rotation_y(i as f32 * 2.39996) * Quat::from_rotation_x(0.25 + 1.5 * (i as f32 / 16.0));
            let at = Vec3::new(x + 0.52, -0.88, z) + lean * Vec3::new(0.0, -0.14, 0.0);
            let leaf = Shape::rounded(0.05, 0.24, 0.014, 0.007);
            self.add(Object::new(leaf, cloth(0x2d6a4f, 0x95d5b2, 0.05)).at(at.x, at.y, at.z).turned(lean));
        }
        self.mug((x + 0.27, z + 0.08), 0.72, 0xbc4749);
    }

    pub(crate) fn floor_lamp(&mut self, x: f32, z: f32) {
        let metal = plain(0x37322e);
        self.add(
            Object::new(Shape::Cylinder { radius: 0.15, half_height: 0.02, rounding: 0.012 }, metal).at(x, -0.02, z),
        );
        self.post((x, z), 0.0, 0.016, 1.5, metal);
        let shade: Material =
            Material { glow: 0.35, ..Texture::Stripes { a: colour(0xf2e3bf), b: colour(0xdfc48a), size: 0.05 }.into() };
        self.add(Object::new(Shape::Cone { top: 0.14, bottom: 0.23, half_height: 0.15 }, shade).at(x, -1.6, z));
    }

    /// A tall plant in a pot.
    pub(crate) fn plant(&mut self, x: f32, z: f32) {
        self.pot((x, z), 0.0, 0.2, 0.36, 0xa8502f);
        self.post((x, z), 0.3, 0.17, 0.03, cloth(0x3b2a1e, 0x6b4f3a, 0.03));
        let stem = cloth(0x6b4f2f, 0x8f7345, 0.04);
        for i in 0..26 {
            let step = i as f32 / 26.0;
            let turn = i as f32 * 2.39996;
            let lean = 0.15 + 1.05 * (1.0 - step) + 0.15 * (i as f32 * 1.7).sin();
            let world_from_leaf = Quat::from_rotation_y(turn) * Quat::from_rotation_x(lean);
            let root = Vec3::new(x, -0.45 - 0.75 * step, z);
            let reach = 0.2 + 0.14 * (1.0 - step);
            let mid = root + world_from_leaf * Vec3::new(0.0, -0.5 * reach, 0.0);
            self.add(
                Object::new(Shape::Capsule { radius: 0.007, half_height: 0.5 * reach }, stem)
                    .at(mid.x, mid.y, mid.z)
                    .turned(world_from_leaf),
            );
            let tip = root + world_from_leaf * Vec3::new(0.0, -reach - 0.06, 0.0);
            let droop = world_from_leaf * Quat::from_rotation_x(0.35);
            self.add(
                Object::new(Shape::rounded(0.13, 0.25, 0.016, 0.008), cloth(0x1f5f3a, 0x74b05a, 0.06))
                    .at(tip.x, tip.y, tip.z)
                    .turned(droop),
            );
        }
        self.post((x, z), 0.3, 0.018, 0.95, stem);
    }

    pub(crate) fn toys(&mut self) {
        let ball: Material =
            Texture::Sectors { colours: [colour(0xd7263d), colour(0xf7f5ee), colour(0x1b6ca8)], count: 6 }.into();
        self.add(
            Object::new(Shape::Sphere { radius: 0.16 }, ball)
                .at(0.95, -0.16, -0.55)
                .turned(Quat::from_rotation_x(0.6) * Quat::from_rotation_z(0.4)),
        );
        for (dx, dz, h, turn, c) in [
            (0.0, 0.0, 0.0, 0.2, 0xe63946),
            (0.15, 0.05, 0.0, 0.9, 0x457b9d),
            (0.06, 0.12, 0.0, 0.5, 0xf4a261),
            (0.06, 0.04, 0.1, 1.2, 0x2a9d8f),
        ] {
            let cube: Material = Texture::Checker { a: colour(c), b: colour(0xf5efe0), size: 0.05 }.into();
            self.add(
                Object::new(Shape::rounded(0.1, 0.1, 0.1, 0.008), cube)
                    .at(-0.75 + dx, -h - 0.05, -0.85 + dz)
                    .turned(Quat::from_rotation_y(turn)),
            );
        }
        // A laundry basket by the door.
        let wicker: Material = Texture::Checker { a: colour(0xc79a5b), b: colour(0x8f6633), size: 0.04 }.into();
        self.add(
            Object::new(Shape::Cone { top: 0.21, bottom: 0.16, half_height: 0.21 }, wicker).at(-1.0, -0.21, -1.72),
        );
        self.add(Object::new(Shape::Torus { major: 0.2, minor: 0.022 }, wicker).at(-1.0, -0.42, -1.72));
        self.add(Object::new(Shape::Sphere { radius: 0.17 }, cloth(0xd8e2dc, 0x9d8189, 0.08)).at(-1.0, -0.36, -1.72));
        // A crate with a ball of wool beside the sofa.
        self.soft((1.52, 1.62), 0.0, (0.42, 0.3, 0.42), 0.01, oak());
        self.add(Object::new(Shape::Sphere { radius: 0.09 }, cloth(0xb56576, 0xe56b6f, 0.03)).at(1.45, -0.39, 1.58));
        self.lying_books((1.63, 1.66), 0.3, 3);
    }

    pub(crate) fn wall_decoration(&mut self) {
        // Above the sofa.
        for (x, h, half, motif) in [
            (-0.45, 1.22, Vec2::new(0.42, 0.3), Motif::Landscape),
            (0.35, 1.3, Vec2::new(0.24, 0.32), Motif::Flowers),
            (0.95, 1.38, Vec2::new(0.2, 0.2), Motif::Abstract),
        ] {
            self.picture_on_z(x, HALF_Z, -1.0, h, half, motif);
        }
        // Above the sideboard and beside the dining table.
        self.picture_on_z(-0.12, -HALF_Z, 1.0, 1.34, Vec2::new(0.21, 0.28), Motif::Abstract);
        self.picture_on_z(0.55, -HALF_Z, 1.0, 1.42, Vec2::new(0.38, 0.27), Motif::Landscape);
        self.picture_on_z(1.35, -HALF_Z, 1.0, 1.25, Vec2::new(0.26, 0.33), Motif::Flowers);
        // A clock.
        let ring = Object::new(Shape::Torus { major: 0.17, minor: 0.02 }, walnut());
        let face = Object::new(
            Shape::cylinder(0.17, 0.03),
            Material { grain: 0.05, ..Texture::Clock { radius: 0.17 }.into() },
        );
        let upright = Quat::from_rotation_x(FRAC_PI_2);
        self.add(ring.at(1.55, -1.85, HALF_Z - 0.01).turned(upright));
        self.add(face.at(1.55, -1.85, HALF_Z - 0.01).turned(upright));
        // A wall shelf above the plant with boxes and a vase.
        self.block((-1.6, HALF_Z - 0.1), 1.72, (0.9, 0.03, 0.2), oak());
        for dx in [-0.35, 0.35] {
            self.block((-1.6 + dx, HALF_Z - 0.06), 1.6, (0.03, 0.12, 0.12), oak());
        }
        self.vase((-1.9, HALF_Z - 0.1), 1.75, 0.2, 0xa23e48);
        self.soft((-1.58, HALF_Z - 0.1), 1.75, (0.22, 0.16, 0.15), 0.01, cloth(0x6c584c, 0xdde5b6, 0.07));
        self.globe((-1.3, HALF_Z - 0.1), 1.75);
        // Three plates on the brick wall beside the dining table.
        for (i, c) in [0xe9c46a, 0x2a9d8f, 0xe76f51].into_iter().enumerate() {
            let plate: Material =
                Texture::Sectors { colours: [colour(c), colour(0xf4f1de), colour(0x3d405b)], count: 12 }.into();
            let turn = Quat::from_rotation_z(FRAC_PI_2);
            let (h, z) = (1.25 + 0.34 * i as f32, -1.35 + 0.22 * (i as f32 * PI).cos());
            self.add(
                Object::new(Shape::Cone { top: 0.15, bottom: 0.08, half_height: 0.025 }, plate)
                    .at(HALF_X - 0.03, -h, z)
                    .turned(turn * Quat::from_rotation_y(TAU / 24.0)),
            );
        }
        // Beside the bookshelf, at -x.
        let (x, z) = (-HALF_X, 1.35);
        self.block((x + 0.015, z), 1.15, (0.03, 0.6, 0.5), walnut());
        let print = Texture::Picture { half: Vec2::new(0.21, 0.26), motif: Motif::Abstract };
        self.block((x + 0.02, z), 1.19, (0.03, 0.52, 0.42), print.into());
        let print = Texture::Picture { half: Vec2::new(0.17, 0.24), motif: Motif::Landscape };
        self.block((x + 0.015, -1.5), 1.26, (0.03, 0.56, 0.42), plain(0xe9e2d0));
        self.block((x + 0.02, -1.5), 1.3, (0.03, 0.48, 0.34), print.into());
        // A low chest under it.
        self.soft((x + 0.22, -1.55), 0.0, (0.42, 0.46, 0.7), 0.02, wood(0x7c9a92, 0x52706a));
        self.block((x + 0.43, -1.55), 0.2, (0.015, 0.06, 0.1), plain(0xc9a24a));
        self.soft((x + 0.22, -1.55), 0.46, (0.4, 0.07, 0.66), 0.03, cloth(0xd4a373, 0xfaedcd, 0.1));
    }

    /// A framed picture on a wall across z; `into_room` is the sign of z that leads away from the wall.
    pub(crate) fn picture_on_z(&mut self, x: f32, z: f32, into_room: f32, bottom: f32, half: Vec2, motif: Motif) {
        let frame = if motif == Motif::Abstract { plain(0x2c2926) } else { wood(0xc9a15a, 0x85622c) };
        let (wide, tall) = (2.0 * half.x, 2.0 * half.y);
        self.block((x, z + into_room * 0.01), bottom, (wide, tall, 0.06), frame);
        let mount = half - 0.035;
        self.block((x, z + into_room * 0.014), bottom + 0.035, (2.0 * mount.x, 2.0 * mount.y, 0.06), plain(0xf6f1e4));
        let inner = half - 0.075;
        let print: Material = Material { grain: 0.15, ..Texture::Picture { half: inner, motif }.into() };
        self.block((x, z + into_room * 0.018), bottom + 0.075, (2.0 * inner.x, 2.0 * inner.y, 0.06), print);
    }
}
