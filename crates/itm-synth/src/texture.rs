//! What surfaces look like: patterns worked out from where a point lies, so that they have detail at every distance.

use glam::{Vec2, Vec3};

/// A colour in linear light, each channel 0 to 1.
///
/// `colour(0xff8000)` reads the usual sRGB notation.
pub fn colour(srgb: u32) -> Vec3 {
    let channel = |shift: u32| {
        let v = ((srgb >> shift) & 0xff) as f32 / 255.0;
        if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
    };
    Vec3::new(channel(16), channel(8), channel(0))
}

/// Linear light as sRGB bytes.
pub(crate) fn to_srgb(linear: Vec3) -> [u8; 3] {
    linear.to_array().map(|v| {
        let v = v.clamp(0.0, 1.0);
        let encoded = if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
        (encoded * 255.0).round() as u8
    })
}

/// A motif for a picture on a wall.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motif {
    /// Hills, a lake and the sun.
    Landscape,
    /// Rectangles of colour between black bars.
    Abstract,
    /// A bunch of flowers.
    Flowers,
    /// Sky, clouds and a meadow, as through a window.
    Outside,
}

/// A pattern on a surface. Sizes are metres, colours linear light (see [`colour`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Texture {
    /// One colour.
    Plain(Vec3),
    /// Two colours mixed by noise in space, of about `size` metres.
    Noise {
        /// Where the noise is low.
        a: Vec3,
        /// Where it is high.
        b: Vec3,
        /// Size of its largest blots.
        size: f32,
    },
    /// Squares.
    Checker {
        /// The one square.
        a: Vec3,
        /// The next one.
        b: Vec3,
        /// A square's side.
        size: f32,
    },
    /// Stripes running along the second surface coordinate (upright on walls).
    Stripes {
        /// Ground.
        a: Vec3,
        /// Stripes.
        b: Vec3,
        /// From stripe to stripe.
        size: f32,
    },
    /// Grained wood, the grain running along the shape's x.
    Wood {
        /// Early wood.
        light: Vec3,
        /// Late wood.
        dark: Vec3,
    },
    /// Floor boards along the first surface coordinate.
    Planks {
        /// Brightest boards.
        light: Vec3,
        /// Darkest boards.
        dark: Vec3,
        /// A board's width; they are eight times as long.
        width: f32,
    },
    /// A wall of bricks.
    Bricks {
        /// Bricks, each a little different.
        brick: Vec3,
        /// What lies between them.
        mortar: Vec3,
        /// A brick's length; a third of it is its height.
        length: f32,
    },
    /// Wallpaper with flowers in staggered rows.
    Wallpaper {
        /// Ground.
        ground: Vec3,
        /// Flowers.
        flower: Vec3,
        /// From flower to flower.
        size: f32,
    },
    /// A woven rug with borders and diamonds.
    Rug {
        /// Half of its sides.
        half: Vec2,
        /// Ground, borders, diamonds.
        colours: [Vec3; 3],
    },
    /// A picture.
    Picture {
        /// Half of its sides.
        half: Vec2,
        /// What it shows.
        motif: Motif,
    },
    /// Sectors around the upright axis, as on a beach ball.
    Sectors {
        /// Colours in turn.
        colours: [Vec3; 3],
        /// Number of sectors.
        count: u32,
    },
    /// A book's cover with bands and a title.
    Book {
        /// Cover.
        cover: Vec3,
        /// Bands and title.
        band: Vec3,
        /// Half of the book's height.
        half_height: f32,
    },
    /// A clock's face.
    Clock {
        /// Radius.
        radius: f32,
    },
}

/// How a surface looks: a pattern, how strongly fine noise varies its brightness, and how much light it gives off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Pattern.
    pub texture: Texture,
    /// Share by which fine noise brightens or darkens the pattern; 0 leaves it as it is (a blank wall).
    pub grain: f32,
    /// Light given off, as a multiple of the pattern's colour.
    pub glow: f32,
}

impl From<Texture> for Material {
    fn from(texture: Texture) -> Self {
        Self { texture, grain: 0.25, glow: 0.0 }
    }
}

impl Default for Material {
    fn default() -> Self {
        let (a, b) = (colour(0x8a8f98), colour(0xd8d2c4));
        Texture::Noise { a, b, size: 0.2 }.into()
    }
}

impl Material {
    /// The share of light that comes back at a point, for red, green and blue, in linear light.
    ///
    /// `p` is the point in the shape's coordinates, `uv` its place on the surface, `seed` tells objects of the same
    /// material apart.
    pub(crate) fn albedo(&self, p: Vec3, uv: Vec2, seed: u32) -> Vec3 {
        let base = self.texture.at(p, uv, seed);
        if self.grain == 0.0 {
            return base;
        }
        let grain = noise(p * 23.0, seed ^ 0x51) + 0.7 * noise(p * 71.0, seed ^ 0x52) + 0.5 * noise(p * 5.0, seed);
        (base * (1.0 + self.grain * (2.0 / 2.2 * grain - 1.0))).clamp(Vec3::ZERO, Vec3::ONE)
    }
}

impl Texture {
    fn at(&self, p: Vec3, uv: Vec2, seed: u32) -> Vec3 {
        match *self {
            Self::Plain(c) => c,
            Self::Noise { a, b, size } => a.lerp(b, contrast(fbm(p / size, seed), 2.2)),
            Self::Checker { a, b, size } => {
                let cell = (uv / size).floor();
                let c = if (cell.x + cell.y).rem_euclid(2.0) < 1.0 { a } else { b };
                c * (0.85 + 0.3 * unit(hash(cell.x as i32, cell.y as i32, 7, seed)))
            }
            Self::Stripes { a, b, size } => {
                let x = (uv.x / size).rem_euclid(1.0);
                let thin = (x - 0.72).abs() < 0.035;
                if x < 0.42 || thin { b } else { a }
            }
            Self::Wood { light, dark } => light.lerp(dark, grain(p, seed)),
            Self::Planks { light, dark, width } => {
                let row = (uv.y / width).floor();
                let shift = unit(hash(row as i32, 0, 1, seed));
                let length = 8.0 * width;
                let along = uv.x / length + shift * 5.0;
                let board = along.floor();
                let tone = unit(hash(row as i32, board as i32, 2, seed));
                let c = light.lerp(dark, tone);
                let streaks = grain(Vec3::new(uv.x, uv.y, board * 3.1 + row), seed);
                let gap = ((uv.y / width - row).min(1.0 - (uv.y / width - row)) * width < 0.0025)
                    || ((along - board).min(1.0 - (along - board)) * length < 0.003);
                if gap { dark * 0.25 } else { c * (1.15 - 0.5 * streaks) }
            }
            Self::Bricks { brick, mortar, length } => {
                let height = length / 3.0;
                let row = (uv.y / height).floor();
                let x = uv.x / length + 0.5 * row.rem_euclid(2.0);
                let column = x.floor();
                let joint = 0.012;
                let rough = 0.004 * (noise(p * 90.0, seed) - 0.5);
                let in_joint = (x - column) * length < joint + rough || (uv.y / height - row) * height < joint + rough;
                if in_joint {
                    mortar * (0.8 + 0.4 * noise(p * 60.0, seed))
                } else {
                    let h = hash(column as i32, row as i32, 3, seed);
                    let tinted = brick * (0.55 + 0.9 * unit(h));
                    tinted.lerp(mortar, 0.25 * contrast(fbm(p * 14.0, h), 2.0))
                }
            }
            Self::Wallpaper { ground, flower, size } => {
                let row = (uv.y / size).floor();
                let x = uv.x / size + 0.5 * row.rem_euclid(2.0);
                let cell = Vec2::new(x - x.floor(), uv.y / size - row) - 0.5;
                let h = hash(x.floor() as i32, row as i32, 4, seed);
                let (r, angle) = (cell.length(), cell.x.atan2(cell.y) + unit(h));
                let petals = 0.2 + 0.11 * (6.0 * angle).cos();
                let stem = cell.y > 0.0 && (cell.x - 0.12 * (9.0 * cell.y).sin()).abs() < 0.022;
                if r < 0.07 {
                    colour(0xe8b23c)
                } else if r < petals {
                    flower * (0.7 + 0.6 * unit(h))
                } else if stem {
                    colour(0x5b7f4b)
                } else {
                    ground
                }
            }
            Self::Rug { half, colours: [ground, border, diamond] } => {
                let edge = (half - uv.abs()).min_element();
                let weave = 0.82 + 0.36 * noise(p * Vec3::new(160.0, 1.0, 60.0), seed);
                let band = (edge / 0.05).floor() as i32;
                let step = ((uv.x + uv.y).abs() * 14.0).fract() < 0.5;
                let c = match band {
                    0 => border,
                    1 if step => ground,
                    1 => diamond,
                    2 => border * 0.6,
                    _ => {
                        let cell = Vec2::new((uv.x / 0.3).rem_euclid(1.0), (uv.y / 0.3).rem_euclid(1.0)) - 0.5;
                        let ring = cell.x.abs() + cell.y.abs();
                        match (ring * 8.0).floor() as i32 {
                            0 => border,
                            1 => diamond * 0.7,
                            2 => diamond,
                            3 => ground * 0.6,
                            6.. => border * 0.8,
                            _ => ground,
                        }
                    }
                };
                c * weave
            }
            Self::Picture { half, motif } => picture(uv / half, motif, seed),
            Self::Sectors { colours, count } => {
                let turn = (p.x.atan2(p.z) / std::f32::consts::TAU + 0.5) * count as f32;
                let cap = p.y.abs() > 0.93 * p.length();
                if cap { Vec3::ONE * 0.85 } else { colours[turn.floor() as usize % 3] }
            }
            Self::Book { cover, band, half_height } => {
                let y = uv.y / half_height;
                let title = y.abs() < 0.45 && (y * 9.0).rem_euclid(1.0) < 0.62 && uv.x.abs() < 0.009;
                let bands = (y.abs() - 0.72).abs() < 0.05 || y.abs() > 0.93;
                if bands || title { band } else { cover }
            }
            Self::Clock { radius } => {
                let (r, turn) = (uv.length() / radius, uv.x.atan2(-uv.y) / std::f32::consts::TAU);
                let near = |at: f32, wide: f32| ((turn - at + 0.5).rem_euclid(1.0) - 0.5).abs() * r < wide;
                let hour = (turn * 12.0 + 0.5).rem_euclid(1.0) - 0.5;
                let mark = (0.78..0.92).contains(&r) && hour.abs() < 0.09;
                let hands = (r < 0.5 && near(0.845, 0.013)) || (r < 0.75 && near(0.15, 0.009)) || r < 0.06;
                if mark || hands { Vec3::splat(0.02) } else { colour(0xf3efe4) }
            }
        }
    }
}

/// Grain of wood that grew along x, 0 to 1.
fn grain(p: Vec3, seed: u32) -> f32 {
    let warped = p * Vec3::new(0.9, 9.0, 9.0) + 0.6 * noise(p * Vec3::new(1.3, 6.0, 6.0), seed);
    let rings = 0.5 + 0.5 * (warped.y * 3.1 + warped.z * 2.3 + 4.0 * noise(warped, seed ^ 1)).sin();
    let fibres = fbm(p * Vec3::new(5.0, 130.0, 130.0), seed ^ 2);
    (0.55 * rings + 0.45 * contrast(fibres, 1.8)).clamp(0.0, 1.0)
}

/// A picture over `uv` from -1 (left, top) to 1.
fn picture(uv: Vec2, motif: Motif, seed: u32) -> Vec3 {
    let q = Vec3::new(uv.x, uv.y, 0.0);
    match motif {
        Motif::Landscape => {
            let ridge =
                |height: f32, rough: f32, s: u32| height - rough * fbm(Vec3::new(uv.x * 2.3, 0.0, s as f32), seed ^ s);
            if uv.distance(Vec2::new(0.45, -0.5)) < 0.16 {
                colour(0xfff0b0)
            } else if uv.y < ridge(0.15, 0.75, 1) {
                colour(0xf49d6e).lerp(colour(0x4d6fb3), (-uv.y * 0.9 + 0.1).clamp(0.0, 1.0))
                    + 0.25 * (contrast(fbm(q * Vec3::new(2.0, 7.0, 1.0), seed), 2.5) - 0.3).max(0.0)
            } else if uv.y < ridge(0.5, 0.7, 2) {
                colour(0x5c5b86) * (0.8 + 0.5 * fbm(q * 9.0, seed))
            } else if uv.y < ridge(0.75, 0.5, 3) {
                colour(0x2f5d50) * (0.6 + 0.9 * fbm(q * 16.0, seed))
            } else {
                colour(0x8fb8c9).lerp(colour(0x274b66), contrast(fbm(q * Vec3::new(3.0, 30.0, 1.0), seed), 2.5))
            }
        }
        Motif::Abstract => {
            let (x, y) = (uv.x * 1.9 + 0.3, uv.y * 2.3 + 0.2);
            let y = y + 0.5 * unit(hash(x.floor() as i32, 0, 5, seed));
            let bar = x.rem_euclid(1.0) < 0.06 || y.rem_euclid(1.0) < 0.07;
            let palette = [0xd8392b, 0xf2efe4, 0x2354a4, 0xf0c62e, 0xf2efe4, 0x1d8a72];
            let h = hash(x.floor() as i32, y.floor() as i32, 6, seed);
            if bar { Vec3::splat(0.015) } else { colour(palette[h as usize % palette.len()]) }
        }
        Motif::Flowers => {
            let mut c = colour(0xe9dcc3) * (0.8 + 0.4 * fbm(q * 4.0, seed));
            if uv.y > 0.1 && (uv.x * (1.0 + 0.5 * uv.y)).abs() < 0.3 {
                c = colour(0x3a6ea5) * (0.7 + 0.6 * fbm(q * 11.0, seed));
            }
            for i in 0..9 {
                let h = hash(i, 1, 8, seed);
                let at = Vec2::new(unit(h) * 1.3 - 0.65, unit(hash(i, 2, 8, seed)) - 0.85);
                let d = (uv - at) * Vec2::new(1.0, 1.1);
                let reach = 0.15 + 0.1 * unit(hash(i, 3, 8, seed));
                let petals = reach * (0.75 + 0.25 * (5.0 * d.x.atan2(d.y) + i as f32).cos());
                if d.length() < 0.3 * reach {
                    c = colour(0x5a3216);
                } else if d.length() < petals {
                    c = colour([0xd9432f, 0xf08cb0, 0xf6c445, 0x9b59b6][h as usize % 4]) * (0.8 + 0.4 * unit(h));
                }
            }
            c
        }
        Motif::Outside => {
            let hills = 0.35 - 0.3 * fbm(Vec3::new(uv.x * 1.7, 0.0, 2.0), seed);
            if uv.y < hills {
                let cloud = contrast(fbm(q * Vec3::new(1.6, 4.0, 1.0), seed), 3.0);
                colour(0x5c9ce6).lerp(colour(0xffffff), (cloud + 0.5 * (uv.y + 0.3)).clamp(0.0, 1.0))
            } else {
                colour(0x7fb04f).lerp(colour(0x2f5f2a), contrast(fbm(q * 7.0, seed), 2.5))
            }
        }
    }
}

/// Spreads values around one half.
fn contrast(v: f32, gain: f32) -> f32 {
    ((v - 0.5) * gain + 0.5).clamp(0.0, 1.0)
}

/// Well-mixed bits of a lattice point (the finaliser of MurmurHash3 over a linear mix).
fn hash(x: i32, y: i32, z: i32, seed: u32) -> u32 {
    let mut h = seed.wrapping_mul(0x9e37_79b9)
        ^ (x as u32).wrapping_mul(0x85eb_ca6b)
        ^ (y as u32).wrapping_mul(0xc2b2_ae35)
        ^ (z as u32).wrapping_mul(0x27d4_eb2f);
    h = (h ^ (h >> 16)).wrapping_mul(0x85eb_ca6b);
    h = (h ^ (h >> 13)).wrapping_mul(0xc2b2_ae35);
    h ^ (h >> 16)
}

/// 0 to 1.
fn unit(h: u32) -> f32 {
    (h >> 8) as f32 / 16_777_216.0
}

/// Value noise on the unit lattice, 0 to 1.
fn noise(p: Vec3, seed: u32) -> f32 {
    let cell = p.floor();
    let f = p - cell;
    let w = f * f * (Vec3::splat(3.0) - 2.0 * f);
    let (x, y, z) = (cell.x as i32, cell.y as i32, cell.z as i32);
    let corner = |dx, dy, dz| unit(hash(x.wrapping_add(dx), y.wrapping_add(dy), z.wrapping_add(dz), seed));
    let edge = |dy, dz| {
        let a: f32 = corner(0, dy, dz);
        a + w.x * (corner(1, dy, dz) - a)
    };
    let side = |dz| {
        let a: f32 = edge(0, dz);
        a + w.y * (edge(1, dz) - a)
    };
    let a: f32 = side(0);
    a + w.z * (side(1) - a)
}

/// Four octaves of noise, 0 to 1 (fractional Brownian motion).
fn fbm(p: Vec3, seed: u32) -> f32 {
    let (mut sum, mut amplitude, mut q) = (0.0, 8.0 / 15.0, p);
    for octave in 0..4 {
        sum += amplitude * noise(q, seed.wrapping_add(octave));
        amplitude *= 0.5;
        q *= 2.03;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_survive_linear_light() {
        for srgb in [0x000000, 0xffffff, 0x0a80f3, 0x7f0102] {
            let [r, g, b] = to_srgb(colour(srgb));
            assert_eq!(u32::from_be_bytes([0, r, g, b]), srgb);
        }
    }

    #[test]
    fn noise_stays_in_range_and_has_no_jumps() {
        let mut last = noise(Vec3::new(-3.0, 0.3, 0.7), 1);
        let (mut lo, mut hi) = (last, last);
        for i in 1..6000 {
            let v = noise(Vec3::new(-3.0 + 0.001 * i as f32, 0.3, 0.7), 1);
            assert!((v - last).abs() < 0.003, "a jump at {i}: {last} to {v}");
            (lo, hi, last) = (lo.min(v), hi.max(v), v);
        }
        assert!(lo >= 0.0 && hi <= 1.0 && hi - lo > 0.3, "from {lo} to {hi}");
    }
}
