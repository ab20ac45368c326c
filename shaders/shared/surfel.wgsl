// Surfels (Keller et al. 2013): a disc's place and confidence in one plane; normal, radius, time of its last observation and
// colour in another. A confidence of 0 marks a slot without a surfel, as zeroed memory has it.

// What a surfel's second part is: normal as two 16-bit numbers (octahedral), radius and submap, the frame that last saw it, and its
// colour from the lowest byte up, with the number of colours fused in the highest.
alias Attributes = vec4<u32>;

// Words of the counters.
const USED: u32 = 0u;
const FREE: u32 = 1u;
const TAKEN: u32 = 2u;
const SEEN: u32 = 3u;
const NEW: u32 = 4u;
const DROPPED: u32 = 5u;
const UPDATED: u32 = 6u;
const MERGED: u32 = 7u;
const REMOVED: u32 = 8u;
const STABLE: u32 = 9u;
const DEMOTED: u32 = 10u;

// Of a surfel's target: it stands in front of what the pixel measures.
const IN_FRONT: u32 = 0x80000000u;
// And that it was seen more than once.
const KNOWN: u32 = 0x40000000u;

// And that it is unstable, and was not observed for a while.
const OLD: u32 = 0x20000000u;
// And that the measurement, which does not stand before it, is not its own.
const REFUTED: u32 = 0x10000000u;

// The pixel that a target, which is not 0, means.
fn pixel_of(goal: u32) -> u32 {
    return (goal & ~(IN_FRONT | KNOWN | OLD | REFUTED)) - 1u;
}

// Of the complement of a depth's bits, which always has it: it is left to discs that are known well enough, so that they come first.
const PREFERRED: u32 = 0x80000000u;

// How near a depth is: the complement of its bits, of which the largest is the nearest, and first of all whether it is of a disc that is preferred. 0, as
// zeroed memory has it, is none.
fn nearness_of(z: f32, is_preferred: bool) -> u32 {
    let bits = ~bitcast<u32>(z);
    return select(bits & ~PREFERRED, bits, is_preferred);
}

fn depth_of(nearness: u32) -> f32 {
    return bitcast<f32>(~(nearness | PREFERRED));
}

// The depth up to which others are of the same surface as the nearest: metres, and standard deviations more.
fn last_depth(z: f32, window_m: f32, window_deviations: f32) -> f32 {
    return z + window_m + window_deviations * depth_deviation(z);
}

// How well a surfel is known, in sixteenths of powers of two, from 1/64 to 1024.
fn rank_of(confidence: f32) -> u32 {
    // Positive floats are in the order of their bits.
    return clamp(bitcast<u32>(confidence) >> 19u, LEAST_RANK, LEAST_RANK + 255u) - LEAST_RANK;
}

// A surfel of a list by its rank and by its place there: the largest key is that of the best known, and of several alike of the
// first. Never 0.
fn key_of(confidence: f32, place: u32) -> u32 {
    return key_of_rank(rank_of(confidence), place);
}

fn key_of_rank(rank: u32, place: u32) -> u32 {
    return (rank << 24u) | (LAST_PLACE - place);
}

fn rank_of_key(key: u32) -> u32 {
    return key >> 24u;
}

fn place_of(key: u32) -> u32 {
    return LAST_PLACE - (key & LAST_PLACE);
}

// What later passes want to know of a surfel in view in one word: its depth, to a ten thousandth, whether it is preferred, and its rank.
fn mark_of(z: f32, confidence: f32, preferred: f32) -> u32 {
    return (bitcast<u32>(z) & MARK_DEPTH) | select(0u, PREFERRED, confidence >= preferred) | rank_of(confidence);
}

fn depth_of_mark(mark: u32) -> f32 {
    return bitcast<f32>(mark & MARK_DEPTH);
}

fn rank_of_mark(mark: u32) -> u32 {
    return mark & 255u;
}

const MARK_DEPTH: u32 = 0x7fffff00u;
const LEAST_RANK: u32 = 1936u;
// Lists are shorter.
const LAST_PLACE: u32 = 0xffffffu;

// A radius in metres and the number of a submap, in 16 bits each: radii are kept by their logarithm, to 0.02 %.
fn pack_size(radius: f32, submap: u32) -> u32 {
    let steps = clamp(floor((log2(max(radius, 1e-30)) + 16.0) * 2048.0 + 0.5), 0.0, 65535.0);
    return u32(steps) | (submap << 16u);
}

fn unpack_radius(size: u32) -> f32 {
    return exp2(f32(size & 0xffffu) / 2048.0 - 16.0);
}

fn submap_of(size: u32) -> u32 {
    return size >> 16u;
}

fn unpack_normal(word: u32) -> vec3<f32> {
    let e = unpack2x16snorm(word);
    var n = vec3(e, 1.0 - abs(e.x) - abs(e.y));
    let fold = max(-n.z, 0.0);
    n.x += select(fold, -fold, n.x >= 0.0);
    n.y += select(fold, -fold, n.y >= 0.0);
    return normalize(n);
}

// Of a unit vector (Cigolle et al. 2014, A Survey of Efficient Representations for Independent Unit Vectors).
fn pack_normal(n: vec3<f32>) -> u32 {
    let p = n.xy / (abs(n.x) + abs(n.y) + abs(n.z));
    let signs = select(vec2(-1.0), vec2(1.0), p >= vec2(0.0));
    return pack2x16snorm(select(p, (1.0 - abs(p.yx)) * signs, n.z < 0.0));
}

// A Kinect's standard deviation of depth in metres (Nguyen et al. 2012).
fn depth_deviation(z: f32) -> f32 {
    let beyond = max(z - 0.4, 0.0);
    return 0.0012 + 0.0019 * beyond * beyond;
}
