//! Blocks of voxels as a whole.

use bytemuck::{cast, cast_slice, cast_slice_mut};

use crate::voxel::{BLOCK_VOXELS, ColourVoxel, DistanceKind, DistanceVoxel, FloatVoxel, VoxelKind};

/// Merges two blocks that hold the same place, as when a block comes back to where another one has been integrated
/// meanwhile: `into` becomes what both have seen.
///
/// A block is [`VoxelKind::block_words`] words, its planes one after the other. Each voxel's distance and colour become the
/// means of both sides, weighted by how often each was observed; the weights add up, as integration lets them, to
/// `max_weight` at most (colours' to 255 as well). Confidences add up to the same limit.
///
/// A side without weight has nothing to say: where `from` has none `into` stays as it is, and where `into` has none it
/// becomes `from`, both to the bit, even where the weight there is already above `max_weight`.
///
/// # Panics
/// Where a block's length is not the kind's.
pub fn merge_blocks(kind: VoxelKind, into: &mut [u32], from: &[u32], max_weight: u16) {
    assert_eq!((into.len(), from.len()), (kind.block_words(), kind.block_words()), "words of blocks of {kind:?}");
    let (into_distances, into_rest) = into.split_at_mut(kind.distance_words() * BLOCK_VOXELS);
    let (from_distances, from_rest) = from.split_at(kind.distance_words() * BLOCK_VOXELS);
    match kind.distance {
        DistanceKind::I16 => merge_plane(into_distances, from_distances, |a, b| merge_distances(a, b, max_weight)),
        DistanceKind::F32 => merge_plane(into_distances, from_distances, |a, b| merge_floats(a, b, max_weight)),
    }
    let colours = if kind.colour { BLOCK_VOXELS } else { 0 };
    let (into_colours, into_confidences) = into_rest.split_at_mut(colours);
    let (from_colours, from_confidences) = from_rest.split_at(colours);
    merge_plane(into_colours, from_colours, |a, b| merge_colours(a, b, max_weight));
    merge_plane(into_confidences, from_confidences, |a, b| merge_confidences(a, b, max_weight));
}

/// Merges one plane, voxel by voxel.
fn merge_plane<T: bytemuck::Pod>(into: &mut [u32], from: &[u32], merge: impl Fn(T, T) -> T) {
    for (a, b) in cast_slice_mut::<u32, T>(into).iter_mut().zip(cast_slice::<u32, T>(from)) {
        *a = merge(*a, *b);
    }
}

/// The mean of two distances of 16 bits.
fn merge_distances(a: DistanceVoxel, b: DistanceVoxel, max_weight: u16) -> DistanceVoxel {
    match (a.weight(), b.weight()) {
        (_, 0) => a,
        (0, _) => b,
        (wa, wb) => {
            DistanceVoxel::new(weighted_mean(a.distance(), wa, b.distance(), wb), wa.saturating_add(wb).min(max_weight))
        }
    }
}

/// The mean of two distances in single precision.
fn merge_floats(a: FloatVoxel, b: FloatVoxel, max_weight: u16) -> FloatVoxel {
    match (a.weight(), b.weight()) {
        (_, 0) => a,
        (0, _) => b,
        (wa, wb) => {
            FloatVoxel::new(weighted_mean(a.distance(), wa, b.distance(), wb), wa.saturating_add(wb).min(max_weight))
        }
    }
}

/// Written so that two equal distances stay what they are.
fn weighted_mean(a: f32, weight_a: u16, b: f32, weight_b: u16) -> f32 {
    let (wa, wb) = (f32::from(weight_a), f32::from(weight_b));
    a + (b - a) * (wb / (wa + wb))
}

/// The mean of two colours, in whole numbers: halves round up.
fn merge_colours(a: ColourVoxel, b: ColourVoxel, max_weight: u16) -> ColourVoxel {
    let (wa, wb) = (u32::from(a.weight()), u32::from(b.weight()));
    match (wa, wb) {
        (_, 0) => a,
        (0, _) => b,
        _ => {
            let sum = wa + wb;
            let mean = |channel: usize| {
                let weighted = u32::from(a.rgb()[channel]) * wa + u32::from(b.rgb()[channel]) * wb;
                ((weighted + sum / 2) / sum) as u8
            };
            ColourVoxel::new([mean(0), mean(1), mean(2)], sum.min(max_weight.into()).min(255) as u8)
        }
    }
}

/// The sum of two confidences, each the bits of a float.
fn merge_confidences(a: u32, b: u32, max_weight: u16) -> u32 {
    match (cast::<u32, f32>(a), cast::<u32, f32>(b)) {
        (_, 0.0) => a,
        (0.0, _) => b,
        (ca, cb) => (ca + cb).min(max_weight.into()).to_bits(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const KINDS: [VoxelKind; 3] = [
        VoxelKind { distance: DistanceKind::I16, colour: false, confidence: false },
        VoxelKind { distance: DistanceKind::I16, colour: true, confidence: true },
        VoxelKind { distance: DistanceKind::F32, colour: true, confidence: false },
    ];

    /// A block of voxels as integration leaves them, from a few that repeat.
    fn block(kind: VoxelKind, voxels: &[(f32, u16, [u8; 3], u8, f32)]) -> Vec<u32> {
        let voxel = |i: usize| voxels[i % voxels.len()];
        let mut words = Vec::new();
        for i in 0..BLOCK_VOXELS {
            let (distance, weight, ..) = voxel(i);
            match kind.distance {
                DistanceKind::I16 => words.push(DistanceVoxel::new(distance, weight).0),
                DistanceKind::F32 => words.extend(cast::<FloatVoxel, [u32; 2]>(FloatVoxel::new(distance, weight))),
            }
        }
        if kind.colour {
            words.extend((0..BLOCK_VOXELS).map(|i| ColourVoxel::new(voxel(i).2, voxel(i).3).0));
        }
        if kind.confidence {
            words.extend((0..BLOCK_VOXELS).map(|i| voxel(i).4.to_bits()));
        }
        words
    }

    fn voxels() -> impl Strategy<Value = Vec<(f32, u16, [u8; 3], u8, f32)>> {
        let weight = || prop_oneof![1 => Just(0), 3 => 1..300u16];
        let voxel = (-1.0..=1.0f32, weight(), any::<[u8; 3]>(), weight(), prop_oneof![Just(0.0), 0.1..90.0f32])
            .prop_map(|(distance, w, rgb, colour_w, confidence)| {
                (distance, w, rgb, colour_w.min(255) as u8, confidence)
            });
        prop::collection::vec(voxel, 1..40)
    }

    proptest! {
        #[test]
        fn both_sides_count_by_their_weights(a in voxels(), b in voxels(), kind in 0..3usize, max_weight in 1..400u16) {
            let kind = KINDS[kind];
            let (block_a, block_b) = (block(kind, &a), block(kind, &b));
            let mut merged = block_a.clone();
            merge_blocks(kind, &mut merged, &block_b, max_weight);
            for i in 0..BLOCK_VOXELS {
                let (a, b) = (a[i % a.len()], b[i % b.len()]);
                let (distance, weight) = match kind.distance {
                    DistanceKind::I16 => (DistanceVoxel(merged[i]).distance(), DistanceVoxel(merged[i]).weight()),
                    DistanceKind::F32 => {
                        let voxel: FloatVoxel = cast([merged[2 * i], merged[2 * i + 1]]);
                        (voxel.distance(), voxel.weight())
                    }
                };
                let (wa, wb) = (f64::from(a.1), f64::from(b.1));
                if wa * wb > 0.0 {
                    let mean = (f64::from(a.0) * wa + f64::from(b.0) * wb) / (wa + wb);
                    prop_assert!((f64::from(distance) - mean).abs() < 1.01 / 32767.5, "{distance} {mean}");
                    prop_assert_eq!(weight, (a.1 + b.1).min(max_weight));
                } else {
                    prop_assert_eq!(weight, a.1 + b.1);
                }
                if kind.colour {
                    let colour = ColourVoxel(merged[kind.distance_words() * BLOCK_VOXELS + i]);
                    let (wa, wb) = (f64::from(a.3), f64::from(b.3));
                    if wa * wb > 0.0 {
                        for c in 0..3 {
                            let mean = (f64::from(a.2[c]) * wa + f64::from(b.2[c]) * wb) / (wa + wb);
                            prop_assert!((f64::from(colour.rgb()[c]) - mean).abs() <= 0.5);
                        }
                        let sum = u16::from(a.3) + u16::from(b.3);
                        prop_assert_eq!(u16::from(colour.weight()), sum.min(max_weight).min(255));
                    }
                }
                if kind.confidence {
                    let confidence = f32::from_bits(merged[(kind.words() - 1) * BLOCK_VOXELS + i]);
                    let sum = a.4 + b.4;
                    let expected = if a.4 * b.4 > 0.0 { sum.min(max_weight.into()) } else { sum };
                    prop_assert_eq!(confidence, expected);
                }
            }
        }

        #[test]
        fn what_was_never_seen_changes_nothing(a in voxels(), kind in 0..3usize, max_weight in 1..400u16) {
            let kind = KINDS[kind];
            let seen = block(kind, &a);
            let unseen = vec![0; kind.block_words()];
            let mut merged = seen.clone();
            merge_blocks(kind, &mut merged, &unseen, max_weight);
            prop_assert_eq!(&merged, &seen);
            // A voxel without weight may still hold a distance; it takes no part, whichever side it is on.
            let voxel = |v: &(f32, u16, [u8; 3], u8, f32)| (v.0, v.1.max(1), v.2, v.3.max(1), v.4);
            let seen = block(kind, &a.iter().map(voxel).collect::<Vec<_>>());
            let mut merged = block(kind, &a.iter().map(|v| (v.0, 0, v.2, 0, 0.0)).collect::<Vec<_>>());
            merge_blocks(kind, &mut merged, &seen, max_weight);
            prop_assert_eq!(&merged, &seen);
        }

        #[test]
        fn sides_may_change_places(a in voxels(), b in voxels()) {
            let kind = VoxelKind { colour: true, confidence: true, ..VoxelKind::default() };
            let (a, b) = (block(kind, &a), block(kind, &b));
            let (mut ab, mut ba) = (a.clone(), b.clone());
            merge_blocks(kind, &mut ab, &b, 100);
            merge_blocks(kind, &mut ba, &a, 100);
            // Voxels without weight on either side keep the distance that was there.
            let weighted = |w: &u32| w >> 16 != 0;
            let (distances, rest) = ab.split_at(BLOCK_VOXELS);
            for (x, y) in distances.iter().zip(&ba).filter(|(x, _)| weighted(x)) {
                prop_assert!((x & 0xffff).abs_diff(y & 0xffff) <= 1 && x >> 16 == y >> 16);
            }
            for (x, y) in rest[..BLOCK_VOXELS].iter().zip(&ba[BLOCK_VOXELS..]).filter(|(x, _)| *x >> 24 != 0) {
                prop_assert_eq!(x, y);
            }
            prop_assert_eq!(&rest[BLOCK_VOXELS..], &ba[2 * BLOCK_VOXELS..]);
        }
    }
}
