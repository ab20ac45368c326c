//! Signed distances between voxels.
//!
//! One formula for whoever asks a map for the distance at a point: the stage `query` on the device, its reference, and the host
//! for blocks that do not lie on the device.

use bytemuck::cast_slice;
use glam::{DVec3, IVec3, Vec3};

use crate::voxel::{
    BLOCK_SIDE, BLOCK_VOXELS, ColourVoxel, DistanceKind, DistanceVoxel, FloatVoxel, VoxelKind, index_in_block,
};

/// The distance of a point from the nearest surface, as a map knows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Signed distance in metres, positive in front of surfaces, at most the truncation band either way.
    pub distance_m: f32,
    /// Its gradient with respect to the point (world frame, without unit): of length one near a smooth surface, zero where the
    /// distance is truncated.
    pub gradient: Vec3,
}

/// The cube of eight voxels around a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// The voxel at its lowest corner.
    pub base: IVec3,
    /// Where the point lies in it, 0 to 1 along each axis.
    pub fraction: DVec3,
}

impl Cell {
    /// The cell around a point (world frame, metres); `None` where the point is no number, or lies further from the origin
    /// than blocks can be numbered.
    pub fn around(point: Vec3, voxel_size_m: f32) -> Option<Self> {
        Self::at(point.as_dvec3() / f64::from(voxel_size_m))
    }

    /// The same for a position in voxels.
    pub fn at(position: DVec3) -> Option<Self> {
        // The numbers of blocks have 16 bits; one voxel is left for rounding on either side.
        let reach = f64::from(i16::MAX) * f64::from(BLOCK_SIDE) - 1.0;
        let base = position.floor();
        // Also refused: what is not a number.
        (position.abs().max_element() < reach && position.is_finite())
            .then(|| Self { base: base.as_ivec3(), fraction: position - base })
    }

    /// Its eight voxels, x fastest.
    pub fn voxels(&self) -> [IVec3; 8] {
        std::array::from_fn(|c| {
            let c = c as i32;
            self.base + IVec3::new(c & 1, (c >> 1) & 1, c >> 2)
        })
    }

    /// How much each of its voxels counts in trilinear interpolation: from 0 to 1, 1 together.
    pub fn shares(&self) -> [f64; 8] {
        let (high, low) = (self.fraction, DVec3::ONE - self.fraction);
        std::array::from_fn(|c| {
            let along = |axis: usize| if c >> axis & 1 == 1 { high[axis] } else { low[axis] };
            along(0) * along(1) * along(2)
        })
    }

    /// The positions of the blocks that its voxels lie in, one to eight, each once.
    pub fn blocks(&self) -> impl Iterator<Item = IVec3> {
        let first = block_of(self.base);
        let more = block_of(self.base + 1) - first;
        let offsets = (0..8).map(|c| IVec3::new(c & 1, (c >> 1) & 1, c >> 2));
        offsets.filter(move |offset| offset.cmple(more).all()).map(move |offset| first + offset)
    }

    /// Interpolates trilinearly between the eight voxels' distances, in units of the truncation band, and weights; the gradient
    /// is the interpolant's own. `None` where one of the voxels was never seen.
    pub fn interpolate(&self, voxels: [(f32, u16); 8], voxel_size_m: f32, truncation_m: f32) -> Option<Sample> {
        if voxels.iter().any(|(_, weight)| *weight == 0) {
            return None;
        }
        let d = voxels.map(|(distance, _)| f64::from(distance));
        let f = self.fraction;
        let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
        let along_x: [f64; 4] = std::array::from_fn(|i| mix(d[2 * i], d[2 * i + 1], f.x));
        let slopes_x: [f64; 4] = std::array::from_fn(|i| d[2 * i + 1] - d[2 * i]);
        let (low, high) = (mix(along_x[0], along_x[1], f.y), mix(along_x[2], along_x[3], f.y));
        let slope_x = mix(mix(slopes_x[0], slopes_x[1], f.y), mix(slopes_x[2], slopes_x[3], f.y), f.z);
        let slope_y = mix(along_x[1] - along_x[0], along_x[3] - along_x[2], f.z);
        let slope = DVec3::new(slope_x, slope_y, high - low);
        let band = f64::from(truncation_m);
        Some(Sample {
            distance_m: (mix(low, high, f.z) * band) as f32,
            gradient: (slope * (band / f64::from(voxel_size_m))).as_vec3(),
        })
    }
}

/// The position of the block that a voxel lies in.
pub fn block_of(voxel: IVec3) -> IVec3 {
    voxel.div_euclid(IVec3::splat(BLOCK_SIDE))
}

/// Distance, in units of the truncation band, and weight of a voxel by its place in the whole map, from the words of the block
/// that it lies in.
///
/// # Panics
/// Where the block is shorter than its kind says.
pub fn distance_in_block(kind: VoxelKind, words: &[u32], voxel: IVec3) -> (f32, u16) {
    let at = index_in_block(voxel.rem_euclid(IVec3::splat(BLOCK_SIDE)));
    let plane = &words[..kind.distance_words() * BLOCK_VOXELS];
    match kind.distance {
        DistanceKind::I16 => {
            let voxel = DistanceVoxel(plane[at]);
            (voxel.distance(), voxel.weight())
        }
        DistanceKind::F32 => {
            let voxel = cast_slice::<u32, FloatVoxel>(plane)[at];
            (voxel.distance(), voxel.weight())
        }
    }
}

/// Colour of a voxel by its place in the whole map, from the words of the block that it lies in; one that was never seen where
/// the kind has no colours.
///
/// # Panics
/// Where the block is shorter than its kind says.
pub fn colour_in_block(kind: VoxelKind, words: &[u32], voxel: IVec3) -> ColourVoxel {
    let at = kind.colours_at() + index_in_block(voxel.rem_euclid(IVec3::splat(BLOCK_SIDE)));
    if kind.colour { ColourVoxel(words[at]) } else { ColourVoxel::default() }
}

/// Confidence of a voxel by its place in the whole map, from the words of the block that it lies in; 0 where the kind has none.
///
/// # Panics
/// Where the block is shorter than its kind says.
pub fn confidence_in_block(kind: VoxelKind, words: &[u32], voxel: IVec3) -> f32 {
    let at = kind.confidences_at() + index_in_block(voxel.rem_euclid(IVec3::splat(BLOCK_SIDE)));
    if kind.confidence { f32::from_bits(words[at]) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_linear_in_each_coordinate_is_met_exactly(
            point in prop::array::uniform3(-3.0f32..3.0), c in prop::array::uniform8(-0.01f64..0.01),
        ) {
            let (voxel, band) = (0.013f32, 0.05f32);
            let cell = Cell::around(Vec3::from(point), voxel).unwrap();
            let at = |p: DVec3| {
                c[0] + c[1] * p.x + c[2] * p.y + c[3] * p.z + c[4] * p.x * p.y + c[5] * p.x * p.z + c[6] * p.y * p.z
                    + c[7] * p.x * p.y * p.z
            };
            // In the cell's own coordinates, in bands.
            let voxels = cell.voxels().map(|v| (at((v - cell.base).as_dvec3()) as f32, 2));
            let found = cell.interpolate(voxels, voxel, band).unwrap();
            let f = cell.fraction;
            let shared: f64 = cell.shares().iter().zip(voxels).map(|(share, (d, _))| share * f64::from(d)).sum();
            prop_assert!((f64::from(found.distance_m) - shared * f64::from(band)).abs() < 1e-8);
            prop_assert!((f64::from(found.distance_m) - at(f) * f64::from(band)).abs() < 1e-8);
            let h = 1e-4;
            for (axis, unit) in DVec3::AXES.into_iter().enumerate() {
                let slope = (at(f + unit * h) - at(f - unit * h)) / (2.0 * h) * f64::from(band / voxel);
                prop_assert!((f64::from(found.gradient[axis]) - slope).abs() < 1e-6, "{} {slope}", found.gradient);
            }
        }

        #[test]
        fn the_blocks_of_a_cell_are_those_of_its_voxels(point in prop::array::uniform3(-1.0f32..1.0)) {
            let cell = Cell::around(Vec3::from(point), 0.01).unwrap();
            let mut expected: Vec<_> = cell.voxels().map(block_of).map(|b| b.to_array()).to_vec();
            let mut found: Vec<_> = cell.blocks().map(|b| b.to_array()).collect();
            expected.sort_unstable();
            expected.dedup();
            found.sort_unstable();
            prop_assert_eq!(found, expected);
        }
    }

    #[test]
    fn where_a_voxel_was_never_seen_there_is_no_distance() {
        let cell = Cell::around(Vec3::splat(0.5), 0.3).unwrap();
        let mut voxels = [(0.5, 1); 8];
        assert_eq!(cell.interpolate(voxels, 0.3, 1.0).unwrap(), Sample { distance_m: 0.5, gradient: Vec3::ZERO });
        voxels[5].1 = 0;
        assert_eq!(cell.interpolate(voxels, 0.3, 1.0), None);
        for odd in [f32::NAN, f32::INFINITY, -1e30, 3000.0] {
            assert_eq!(Cell::around(Vec3::new(0.0, odd, 0.0), 0.01), None);
        }
    }
}
