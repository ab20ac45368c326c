//! What stands along walls: the furniture of the room, and plainer things, for scenes that are made from lists.

use std::f32::consts::{FRAC_PI_2, PI};

use glam::{Quat, Vec2, Vec3};

use crate::furniture::{Builder, cloth, oak, plain, walnut, wood};
use crate::texture::colour;
use crate::{Material, Motif, Object, Shape, Texture};

/// Which way a wall looks into the room.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Facing {
    PlusX,
    MinusX,
    PlusZ,
    MinusZ,
}

impl Facing {
    /// From +z, the way that fittings are described.
    fn turn(self) -> f32 {
        match self {
            Self::PlusZ => 0.0,
            Self::MinusZ => PI,
            Self::PlusX => FRAC_PI_2,
            Self::MinusX => -FRAC_PI_2,
        }
    }
}

/// Something that stands before a wall or hangs on it. How it turns out in detail is a matter of chance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Fitting {
    /// Full of books, 1.9 m wide.
    Bookshelf,
    /// With radio, lamp and plant, 1.5 m wide.
    Sideboard,
    /// With a rail for coats 1 m to its right.
    Door,
    /// With curtains, 2.2 m wide.
    Window,
    /// A pier from floor to ceiling, so many metres wide and deep.
    Pier(f32, f32),
    /// With a basket on it, 1.3 m wide.
    Bench,
    /// A pile of so many boxes, about 0.6 m wide.
    Boxes(usize),
    /// A low chest with a cushion, 0.7 m wide.
    Chest,
    /// A board 1.7 m up, 0.9 m wide, with a few things on it.
    WallShelf,
    Picture(Motif),
    FloorLamp,
    Chair,
}

/// How deep the panels of [`Builder::panel_wall`] are at most, above the dado.
pub(crate) const PANEL_M: f32 = 0.02;

impl Builder {
    /// Puts fittings before a wall that looks `facing`, each around a place at its foot.
    pub(crate) fn fit_wall(&mut self, facing: Facing, fittings: &[((f32, f32), Fitting)]) {
        for &(at, fitting) in fittings {
            self.put((0.0, 0.0), at, facing.turn(), |b| b.fit(fitting));
        }
    }

    /// A fitting around the origin of the floor, before a wall at z = 0 that looks towards +z.
    fn fit(&mut self, fitting: Fitting) {
        match fitting {
            Fitting::Bookshelf => self.put((-2.5, -0.1), (0.0, 0.0), -FRAC_PI_2, Self::bookshelf),
            Fitting::Sideboard => self.put((-0.05, -2.0), (0.0, 0.0), 0.0, Self::sideboard),
            Fitting::Door => self.put((-1.75, -2.0), (0.0, 0.0), 0.0, Self::door),
            Fitting::Window => self.put((2.5, 0.35), (0.0, 0.0), FRAC_PI_2, Self::window),
            Fitting::Pier(wide, deep) => self.pier(wide, deep),
            Fitting::Bench => self.bench(),
            Fitting::Boxes(count) => self.boxes(count),
            Fitting::Chest => self.chest(),
            Fitting::WallShelf => self.wall_shelf(),
            Fitting::Picture(motif) => {
                let half = Vec2::new(self.between(0.24, 0.5), self.between(0.24, 0.4));
                let bottom = self.between(1.1, 1.35);
                self.picture_on_z(0.0, 0.0, 1.0, bottom, half, motif);
            }
            Fitting::FloorLamp => self.floor_lamp(0.0, 0.26),
            Fitting::Chair => {
                let turn = self.between(-0.5, 0.5);
                self.chair(Vec3::new(0.0, 0.0, 0.36), PI + turn, 0.0);
            }
        }
    }

    fn pier(&mut self, wide: f32, deep: f32) {
        let height = self.height();
        let material = self.covering();
        self.block((0.0, 0.5 * deep), 0.0, (wide, height, deep), material);
        let stone = cloth(0x9a948a, 0xd5cfc2, 0.15);
        let base = self.between(0.12, 0.3);
        self.block((0.0, 0.5 * deep + 0.02), 0.0, (wide + 0.08, base, deep + 0.04), stone);
        self.block((0.0, 0.5 * deep + 0.02), height - 0.2, (wide + 0.08, 0.2, deep + 0.04), stone);
    }

    fn bench(&mut self) {
        let z = 0.21;
        self.soft((0.0, z), 0.42, (1.3, 0.06, 0.36), 0.02, oak());
        for x in [-0.55, 0.55] {
            self.block((x, z), 0.0, (0.06, 0.43, 0.3), oak());
        }
        let (at, tall) = (self.between(-0.35, 0.35), self.between(0.15, 0.3));
        self.soft((at, z), 0.48, (0.42, tall, 0.3), 0.05, cloth(0x8d6e8f, 0xd8c4d6, 0.07));
        let shoes = self.between(-0.3, 0.3);
        for dx in [0.0, 0.13] {
            self.soft((shoes + dx, z + 0.02), 0.0, (0.1, 0.09, 0.28), 0.04, cloth(0x2e2a28, 0x6b5a4a, 0.05));
        }
    }

    fn boxes(&mut self, count: usize) {
        let mut bottom = 0.0;
        for _ in 0..count {
            let (side, tall) = (self.between(0.3, 0.46), self.between(0.2, 0.36));
            let (x, turn) = (self.between(-0.08, 0.08), self.between(-0.2, 0.2));
            let c = self.pick(&[0xb98a58, 0xa9784a, 0xc8a06b, 0x5b7d87, 0x8c4a3a, 0x6a7f55]);
            let card = cloth(c, 0xd9b98a, 0.12);
            let long = self.between(1.0, 1.3) * side;
            self.add(
                Object::new(Shape::rounded(long, tall, side, 0.006), card)
                    .at(x, -bottom - 0.5 * tall, 0.32)
                    .turned(Quat::from_rotation_y(turn)),
            );
            bottom += tall;
        }
    }

    fn chest(&mut self) {
        let tall = self.between(0.4, 0.6);
        let c = self.pick(&[0x7c9a92, 0x9a7c62, 0x6f6a8c, 0xa05a4a]);
        self.soft((0.0, 0.22), 0.0, (0.7, tall, 0.42), 0.02, wood(c, 0x4f4640));
        self.block((0.0, 0.43), 0.6 * tall, (0.1, 0.06, 0.02), plain(0xc9a24a));
        self.soft((0.0, 0.22), tall, (0.66, 0.08, 0.4), 0.03, cloth(0xd4a373, 0xfaedcd, 0.1));
        let at = self.between(-0.15, 0.15);
        self.lying_books((at, 0.22), tall + 0.08, 3);
    }

    fn wall_shelf(&mut self) {
        self.block((0.0, 0.1), 1.7, (0.9, 0.03, 0.2), oak());
        for dx in [-0.35, 0.35] {
            self.block((dx, 0.06), 1.58, (0.03, 0.12, 0.12), walnut());
        }
        let (tall, glaze) = (self.between(0.16, 0.26), self.pick(&[0xa23e48, 0x2d7f8a, 0xc9a227, 0x4a5d8f]));
        self.vase((-0.28, 0.1), 1.73, tall, glaze);
        self.globe((0.28, 0.1), 1.73);
        let wide = self.between(0.14, 0.26);
        self.soft((0.02, 0.1), 1.73, (wide, 0.15, 0.15), 0.01, cloth(0x6c584c, 0xdde5b6, 0.07));
    }

    /// One of many papers, paints and bricks for a piece of wall.
    pub(crate) fn covering(&mut self) -> Material {
        const DARK: [u32; 8] = [0x7f95b5, 0xa9573f, 0x6f8f78, 0xb08d62, 0x8a6f8f, 0x5f7f8c, 0x9c6a4f, 0x7d7a55];
        const LIGHT: [u32; 6] = [0xd6c7a1, 0xcfdbe0, 0xe6d3ad, 0xc9d1bd, 0xe0cbd0, 0xc8c2b8];
        let (a, b) = (colour(self.pick(&DARK)), colour(self.pick(&LIGHT)));
        let size = self.between(0.2, 0.36);
        match self.pick(&[0, 1, 2, 3]) {
            0 => Texture::Wallpaper { ground: b, flower: a, size }.into(),
            1 => Texture::Bricks { brick: a, mortar: b, length: 0.25 }.into(),
            2 => Texture::Stripes { a, b, size }.into(),
            _ => Texture::Noise { a, b, size: 2.0 * size }.into(),
        }
    }

    /// Panels of many coverings, each with a dado of its own, along a wall at `z` between two x.
    pub(crate) fn panel_wall(&mut self, (from, to): (f32, f32), z: f32, facing: Facing) {
        let into_room = if facing == Facing::PlusZ { 1.0 } else { -1.0 };
        let mut x = from;
        while x < to {
            let wide = self.between(1.7, 3.4).min(to - x);
            let deep = self.between(0.2, 1.0) * PANEL_M;
            let height = self.height();
            let split = self.between(0.7, 1.2);
            let (below, above) = (self.covering(), self.covering());
            let middle = x + 0.5 * wide;
            self.block((middle, z + into_room * 0.5 * deep), split, (wide, height - split, deep), above);
            self.block((middle, z + into_room * 0.5 * (deep + 0.015)), 0.0, (wide, split, deep + 0.015), below);
            x += wide;
        }
    }
}
