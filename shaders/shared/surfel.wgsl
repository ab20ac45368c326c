// Surfels (Keller et al. 2013): a disc's place and confidence in one plane; normal, radius, time of its last observation and
// colour in another. A confidence of 0 marks a slot without a surfel, as zeroed memory has it.

// What a surfel's second part is: normal as two 16-bit numbers (octahedral), the radius' bits, the frame that last saw it, and its
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

// Of the complement of a depth's bits, which always has it: it is left to discs that are known well enough, so that they come first.
const PREFERRED: u32 = 0x80000000u;

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
