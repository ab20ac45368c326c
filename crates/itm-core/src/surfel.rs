//! Surfels: discs on surfaces, as they lie in memory on host and device alike (Keller et al. 2013, *Real-time 3D
//! Reconstruction in Dynamic Scenes using Point-based Fusion*, section 3).

use glam::Vec3;

use crate::PointCloud;

/// Words of a surfel in memory.
pub const SURFEL_WORDS: usize = 8;

/// A disc on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surfel {
    /// Centre in metres (its submap's frame).
    pub position: Vec3,
    /// Unit normal, pointing into free space. In memory two 16-bit numbers.
    pub normal: Vec3,
    /// Radius in metres. In memory a 16-bit number, to 0.02 %.
    pub radius_m: f32,
    /// The submap that it belongs to, in whose frame it lies.
    pub submap: u16,
    /// How many observations from the image's middle would tell as much of it; above 0.
    pub confidence: f32,
    /// The frame that last observed it, of those that its submap was fused from, counted from 1.
    pub seen: u32,
    /// Red, green, blue; none where no frame had a colour for it.
    pub colour: Option<[u8; 3]>,
}

impl Surfel {
    /// As the device holds it: centre and confidence; normal, radius and submap, last frame, colour. A surfel's number of fused colours is
    /// not known here: it counts as one.
    pub fn to_words(&self) -> [u32; SURFEL_WORDS] {
        let [x, y, z] = self.position.to_array().map(f32::to_bits);
        let colour = self.colour.map_or(0, |[r, g, b]| u32::from_le_bytes([r, g, b, 1]));
        [
            x,
            y,
            z,
            self.confidence.to_bits(),
            pack_normal(self.normal),
            pack_size(self.radius_m, self.submap),
            self.seen,
            colour,
        ]
    }

    /// The inverse of [`Surfel::to_words`]; `None` for a slot without a surfel.
    pub fn from_words(words: [u32; SURFEL_WORDS]) -> Option<Self> {
        let [x, y, z, confidence, normal, size, seen, colour] = words;
        let confidence = f32::from_bits(confidence);
        let [r, g, b, count] = colour.to_le_bytes();
        (confidence > 0.0).then(|| Self {
            position: Vec3::from_array([x, y, z].map(f32::from_bits)),
            normal: unpack_normal(normal),
            radius_m: unpack_radius(size),
            submap: (size >> 16) as u16,
            confidence,
            seen,
            colour: (count > 0).then_some([r, g, b]),
        })
    }
}

/// A radius in metres and the number of a submap, in 16 bits each: radii are kept by their logarithm, from 15 micrometres on.
pub fn pack_size(radius_m: f32, submap: u16) -> u32 {
    let steps = ((radius_m.max(1e-30).log2() + 16.0) * 2048.0 + 0.5).floor().clamp(0.0, 65535.0);
    steps as u32 | (u32::from(submap) << 16)
}

/// The radius in metres that [`pack_size`] packed.
pub fn unpack_radius(size: u32) -> f32 {
    ((size & 0xffff) as f32 / 2048.0 - 16.0).exp2()
}

/// How well a surfel of some confidence is known, in sixteenths of powers of two: 0 up to 1/64, 255 from about 1000 on. Among surfels of one
/// rank the first counts as the best known one.
pub fn confidence_rank(confidence: f32) -> u32 {
    // Positive numbers are in the order of their bits, the exponent before the mantissa.
    let rank = |number: f32| number.to_bits() >> 19;
    (rank(confidence).max(rank(1.0 / 64.0)) - rank(1.0 / 64.0)).min(255)
}

/// Surfels as points: their confidences are the points' confidences. Points have colours where any surfel has one; others are black
/// then.
pub fn cloud_of_surfels(surfels: &[Surfel]) -> PointCloud {
    let coloured = surfels.iter().any(|surfel| surfel.colour.is_some());
    let colours = surfels.iter().map(|surfel| surfel.colour.unwrap_or_default());
    PointCloud {
        positions: surfels.iter().map(|surfel| surfel.position).collect(),
        normals: surfels.iter().map(|surfel| surfel.normal).collect(),
        colours: if coloured { colours.collect() } else { Vec::new() },
        weights: Vec::new(),
        confidences: surfels.iter().map(|surfel| surfel.confidence).collect(),
    }
}

/// A unit vector as two 16-bit numbers on an octahedron (Cigolle et al. 2014, *A Survey of Efficient Representations for
/// Independent Unit Vectors*), at most 6e-5 radians off.
pub fn pack_normal(n: Vec3) -> u32 {
    let [x, y] = [n.x, n.y].map(|v| v / (n.x.abs() + n.y.abs() + n.z.abs()));
    let sign = |v: f32| if v >= 0.0 { 1.0 } else { -1.0 };
    let [x, y] = if n.z < 0.0 { [(1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y)] } else { [x, y] };
    let snorm = |v: f32| u32::from(((v.clamp(-1.0, 1.0) * 32767.0).round() as i16).cast_unsigned());
    snorm(x) | (snorm(y) << 16)
}

/// The inverse of [`pack_normal`].
pub fn unpack_normal(word: u32) -> Vec3 {
    let unit = |bits: u32| (f32::from((bits as u16).cast_signed()) / 32767.0).max(-1.0);
    let (x, y) = (unit(word), unit(word >> 16));
    let z = 1.0 - x.abs() - y.abs();
    let fold = (-z).max(0.0);
    let inwards = |v: f32| if v >= 0.0 { v - fold } else { v + fold };
    Vec3::new(inwards(x), inwards(y), z).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_survive_packing() {
        for i in 0..2000_i32 {
            let (a, b) = (f64::from(i) * 0.61803, f64::from(i) * 0.001 * std::f64::consts::PI);
            let normal = Vec3::new((a.sin() * b.sin()) as f32, (a.cos() * b.sin()) as f32, b.cos() as f32).normalize();
            let off = unpack_normal(pack_normal(normal)).angle_between(normal);
            assert!(off < 6e-4, "{normal} is {off} off");
        }
        for axis in [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z] {
            assert!(unpack_normal(pack_normal(axis)).distance(axis) < 1e-4, "{axis}");
        }
    }

    #[test]
    fn sizes_survive_packing_again_and_again() {
        for submap in [0, 1, 65535] {
            for steps in 0..=65535 {
                let size = steps | (u32::from(submap) << 16);
                assert_eq!(pack_size(unpack_radius(size), submap), size);
            }
        }
        assert_eq!([0.0, -1.0, f32::INFINITY].map(|radius| pack_size(radius, 0)), [0, 0, 65535]);
    }

    #[test]
    fn ranks_follow_confidences() {
        assert_eq!([0.0, 0.001, 1.0 / 64.0, 1.0, 1.0625, 2.0, 1e6].map(confidence_rank), [0, 0, 0, 96, 97, 112, 255]);
        assert!((1..2000).map(|i| confidence_rank(i as f32 * 0.5)).is_sorted());
    }

    #[test]
    fn surfels_survive_packing_and_empty_slots_hold_none() {
        let surfel = Surfel {
            position: Vec3::new(1.0, -2.5, 0.125),
            normal: Vec3::NEG_Z,
            radius_m: 0.003,
            submap: 3,
            confidence: 12.5,
            seen: 77,
            colour: Some([1, 200, 255]),
        };
        let read = Surfel::from_words(surfel.to_words()).expect("a surfel");
        assert!(read.normal.distance(surfel.normal) < 1e-4);
        assert!((read.radius_m / surfel.radius_m - 1.0).abs() < 2e-4, "{}", read.radius_m);
        assert_eq!(Surfel { normal: surfel.normal, radius_m: surfel.radius_m, ..read }, surfel);
        assert_eq!(Surfel::from_words([0; SURFEL_WORDS]), None);
    }
}
