//! Voxels, blocks of voxels and their keys, as they lie in memory on host and device alike.
//!
//! Space is cut into blocks of 8x8x8 voxels (Nießner et al. 2013, *Real-time 3D Reconstruction at Scale using Voxel
//! Hashing*, section 4). Voxel `(i, j, k)` of the whole map samples the signed distance at
//! `voxel_size_m * (i, j, k)`: voxels sit on the lattice, not at the centres of cells.

use glam::IVec3;

/// Voxels along a block's edge.
pub const BLOCK_SIDE: i32 = 8;
/// Voxels in a block.
pub const BLOCK_VOXELS: usize = 512;
/// What the best observation adds to a distance's weight, where observations count by their noise; the least one adds 1, as
/// every one does where all count alike.
pub const BEST_OBSERVATION: u16 = 16;

/// Where a block lies: a submap and the block's corner, in blocks. Packs into 64 bits, 16 for each part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BlockKey {
    /// Submap that the block belongs to.
    pub submap: u16,
    /// Corner in blocks: voxels `8 * position` to `8 * position + 7`. Each part fits 16 bits.
    pub position: IVec3,
}

impl BlockKey {
    /// Words that are no block's key, for an index that no block has. The block whose key packs to them (submap 65535, one
    /// block before the origin along each axis) cannot be kept.
    pub const NO_KEY: [u32; 2] = [u32::MAX; 2];

    /// As two words: `x | y << 16` and `z | submap << 16`, signed parts in two's complement.
    pub fn pack(self) -> [u32; 2] {
        let low = |v: i32| (v as u32) & 0xffff;
        [low(self.position.x) | low(self.position.y) << 16, low(self.position.z) | u32::from(self.submap) << 16]
    }

    /// The inverse of [`BlockKey::pack`].
    pub fn unpack([a, b]: [u32; 2]) -> Self {
        let signed = |v: u32| i32::from(v as u16 as i16);
        Self { submap: (b >> 16) as u16, position: IVec3::new(signed(a), signed(a >> 16), signed(b)) }
    }
}

/// Index of voxel `(x, y, z)`, each 0 to 7, within its block.
pub fn index_in_block(voxel: IVec3) -> usize {
    (voxel.x + voxel.y * BLOCK_SIDE + voxel.z * BLOCK_SIDE * BLOCK_SIDE) as usize
}

/// How a voxel's distance is kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum DistanceKind {
    /// 16 bits, beside a weight of 16 bits in one word: [`DistanceVoxel`].
    #[default]
    I16,
    /// A 32-bit float, and a second word for the weight: [`FloatVoxel`].
    F32,
}

/// What a voxel holds. Each part is a plane of its own, there only where it is asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VoxelKind {
    /// How the distance and its weight are kept.
    pub distance: DistanceKind,
    /// Whether there is a colour: [`ColourVoxel`].
    pub colour: bool,
    /// Whether there is a confidence, a 32-bit float.
    pub confidence: bool,
}

impl VoxelKind {
    /// Words (of 32 bits) of a distance and its weight.
    pub const fn distance_words(self) -> usize {
        match self.distance {
            DistanceKind::I16 => 1,
            DistanceKind::F32 => 2,
        }
    }

    /// Words of a voxel in all planes together.
    pub const fn words(self) -> usize {
        self.distance_words() + self.colour as usize + self.confidence as usize
    }

    /// Where in a block the plane of colours begins, in words.
    pub const fn colours_at(self) -> usize {
        self.distance_words() * BLOCK_VOXELS
    }

    /// Where in a block the plane of confidences begins, in words.
    pub const fn confidences_at(self) -> usize {
        (self.distance_words() + self.colour as usize) * BLOCK_VOXELS
    }

    /// Words of a block: its planes one after the other, distances, colours, confidences.
    pub const fn block_words(self) -> usize {
        self.words() * BLOCK_VOXELS
    }

    /// Bytes of a block.
    pub const fn block_bytes(self) -> u64 {
        self.block_words() as u64 * 4
    }
}

/// A truncated signed distance and how often it was observed, packed into one word: the low half is
/// `(1 - distance) / 2` as a 16-bit fixed-point number, the high half the weight. Zeroed memory is therefore space
/// never seen: distance 1, weight 0.
///
/// The distance is in units of the truncation band, positive in front of surfaces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(transparent)]
pub struct DistanceVoxel(pub u32);

impl DistanceVoxel {
    /// Packs a distance (clamped to -1 to 1) and a weight.
    pub fn new(distance: f32, weight: u16) -> Self {
        let fixed = ((1.0 - distance.clamp(-1.0, 1.0)) * 32767.5).round() as u32;
        Self(fixed | u32::from(weight) << 16)
    }

    /// Signed distance in units of the truncation band, between -1 and 1.
    pub fn distance(self) -> f32 {
        1.0 - (self.0 & 0xffff) as f32 * (1.0 / 32767.5)
    }

    /// Number of observations, each as many times as it counts, up to the largest weight.
    pub fn weight(self) -> u16 {
        (self.0 >> 16) as u16
    }
}

/// A truncated signed distance in single precision and how often it was observed, in two words. The first holds one minus the
/// distance, so that zeroed memory is space never seen here too.
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct FloatVoxel {
    one_minus_distance: f32,
    weight: u32,
}

impl FloatVoxel {
    /// Packs a distance (clamped to -1 to 1) and a weight.
    pub fn new(distance: f32, weight: u16) -> Self {
        Self { one_minus_distance: 1.0 - distance.clamp(-1.0, 1.0), weight: weight.into() }
    }

    /// Signed distance in units of the truncation band, between -1 and 1.
    pub fn distance(self) -> f32 {
        1.0 - self.one_minus_distance
    }

    /// Number of observations, each as many times as it counts, up to the largest weight.
    pub fn weight(self) -> u16 {
        self.weight as u16
    }
}

/// A colour and how often it was observed, packed into one word: red, green, blue, weight from the lowest byte up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(transparent)]
pub struct ColourVoxel(pub u32);

impl ColourVoxel {
    /// Packs a colour and a weight.
    pub fn new(rgb: [u8; 3], weight: u8) -> Self {
        Self(u32::from_le_bytes([rgb[0], rgb[1], rgb[2], weight]))
    }

    /// Red, green, blue.
    pub fn rgb(self) -> [u8; 3] {
        let [r, g, b, _] = self.0.to_le_bytes();
        [r, g, b]
    }

    /// Number of observations, up to 255.
    pub fn weight(self) -> u8 {
        self.0.to_le_bytes()[3]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn keys_survive_packing(submap: u16, x: i16, y: i16, z: i16) {
            let key = BlockKey { submap, position: IVec3::new(x.into(), y.into(), z.into()) };
            prop_assert_eq!(BlockKey::unpack(key.pack()), key);
        }

        #[test]
        fn distances_survive_packing_to_half_a_step(distance in -1.0f32..1.0, weight: u16) {
            let voxel = DistanceVoxel::new(distance, weight);
            prop_assert!((voxel.distance() - distance).abs() <= 0.5 / 32767.5 + 1e-6);
            prop_assert_eq!(voxel.weight(), weight);
        }
    }

    #[test]
    fn zeroed_memory_is_space_never_seen() {
        assert_eq!(DistanceVoxel::default().distance(), 1.0);
        assert_eq!(DistanceVoxel::default().weight(), 0);
        assert_eq!(DistanceVoxel::new(-1.0, 3).distance(), -1.0);
    }
}
