// Depth, and beside it how much each pixel counts in fusion: a whole number of the least observation, 1 to 16. By the
// axial noise of a Kinect (Nguyen et al. 2012), as its variance at its best by that at the pixel's depth, and by the cosine
// of the angle between ray and surface normal (Newcombe et al. 2011, section 3.3).
import package::shared::camera::{Camera, unproject};
import package::shared::weights::{WEIGHT_NOISE, weight_by_depth};

struct Params {
    camera: Camera,
    reach_m: f32,
    unused_a: u32,
    unused_b: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> depth: array<f32>;
@group(0) @binding(2) var<storage, read_write> observations: array<vec2<f32>>;

const LARGEST_WEIGHT: f32 = 16.0;
// Differences of depth over this many pixels to either side: between next neighbours, noise at 2 m tilts a normal by more
// than the surfaces that it should tell apart.
const APART: i32 = 3;

// The vertex at a pixel that may lie outside; w is 0 where there is none near `z`.
fn neighbour(pixel: vec2<i32>, z: f32) -> vec4<f32> {
    if any(pixel < vec2(0)) || any(pixel >= vec2<i32>(params.camera.size)) {
        return vec4(0.0);
    }
    let other = depth[u32(pixel.y) * params.camera.size.x + u32(pixel.x)];
    if other <= 0.0 || abs(other - z) > params.reach_m {
        return vec4(0.0);
    }
    return vec4(unproject(params.camera, vec2<f32>(pixel), other), 1.0);
}

// Cosine of the angle between a pixel's ray and the surface's normal; 0, as at a surface seen from its side, where a
// neighbour is missing or lies on another surface.
fn cosine(pixel: vec2<i32>, z: f32) -> f32 {
    let left = neighbour(pixel - vec2(APART, 0), z);
    let right = neighbour(pixel + vec2(APART, 0), z);
    let above = neighbour(pixel - vec2(0, APART), z);
    let below = neighbour(pixel + vec2(0, APART), z);
    let ray = unproject(params.camera, vec2<f32>(pixel), 1.0);
    let normal = cross(right.xyz - left.xyz, below.xyz - above.xyz);
    let lengths = length(normal) * length(ray);
    let found = left.w * right.w * above.w * below.w > 0.0 && lengths > 1e-20;
    return select(0.0, abs(dot(normal, ray)) / lengths, found);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = params.camera.size;
    if any(id.xy >= size) {
        return;
    }
    let at = id.y * size.x + id.x;
    let z = depth[at];
    let share = weight_by_depth(WEIGHT_NOISE, params.camera.depth_range, z) * cosine(vec2<i32>(id.xy), z);
    // Where there is no depth, integrate passes the pixel over.
    observations[at] = vec2(z, max(floor(share * LARGEST_WEIGHT + 0.5), 1.0));
}
