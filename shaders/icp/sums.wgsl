// Point-to-plane ICP with projective association: each depth pixel against the surface that the model shows there
// (Newcombe et al. 2011, section 3.5; the report, section 3.1.1). An invocation sums over many pixels and writes a row
// of the upper triangle of JᵀJ (21), Jᵀr (6), the sum of r², the number of pairs and that of pixels with a depth. No
// barrier, and always the same order of additions.
import package::shared::camera::{Camera, unproject, project};

struct Params {
    // The depth image's level.
    depth_camera: Camera,
    // The model image, at full resolution.
    model_camera: Camera,
    world_from_camera: mat4x4<f32>,
    model_camera_from_world: mat4x4<f32>,
    // The rotation and translation estimated turn and move the camera about this point (world frame): the model
    // camera's centre, which keeps the system well conditioned far from the origin.
    pivot: vec3<f32>,
    max_distance: f32,
    rows: u32,
    unused_a: u32,
    unused_b: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> depth: array<f32>;
@group(0) @binding(2) var<storage, read> points: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> normals: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> partial_sums: array<f32>;

override LANES: u32 = 64u;
// Pixels that an invocation sums up.
override PIXELS: u32 = 16u;

struct Pair {
    // Derivatives of the residual by translation and rotation.
    translation: vec3<f32>,
    rotation: vec3<f32>,
    residual: f32,
    // 1 for a pair, 0 for none, in which case all before is 0 too.
    count: f32,
    // 1 where the pixel has a depth.
    valid: f32,
}

fn pair(pixel: u32) -> Pair {
    let size = params.depth_camera.size;
    let z = depth[pixel];
    if z <= 0.0 {
        return Pair(vec3(0.0), vec3(0.0), 0.0, 0.0, 0.0);
    }
    let none = Pair(vec3(0.0), vec3(0.0), 0.0, 0.0, 1.0);
    let position = vec2<f32>(vec2(pixel % size.x, pixel / size.x));
    let world = (params.world_from_camera * vec4(unproject(params.depth_camera, position, z), 1.0)).xyz;
    let seen = (params.model_camera_from_world * vec4(world, 1.0)).xyz;
    if seen.z <= 0.0 {
        return none;
    }
    let where_seen = project(params.model_camera, seen) + 0.5;
    if any(where_seen < vec2(0.0)) || any(where_seen >= vec2<f32>(params.model_camera.size)) {
        return none;
    }
    let at = u32(where_seen.y) * params.model_camera.size.x + u32(where_seen.x);
    let model = points[at];
    let normal = normals[at];
    let offset = world - model.xyz;
    if normal.w == 0.0 || dot(offset, offset) > params.max_distance * params.max_distance {
        return none;
    }
    let arm = world - params.pivot;
    return Pair(normal.xyz, cross(arm, normal.xyz), dot(offset, normal.xyz), 1.0, 1.0);
}

@compute @workgroup_size(LANES)
fn main(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3<u32>) {
    let pixels = params.depth_camera.size.x * params.depth_camera.size.y;
    let row = group.x * LANES + lane;
    if row >= params.rows {
        return;
    }
    var tt0 = vec3(0.0); // translation x translation: xx xy xz
    var tt1 = vec3(0.0); // yy yz zz
    var tr0 = vec3(0.0); // translation.x x rotation
    var tr1 = vec3(0.0);
    var tr2 = vec3(0.0);
    var rr0 = vec3(0.0); // rotation x rotation: xx xy xz
    var rr1 = vec3(0.0); // yy yz zz
    var gt = vec3(0.0);
    var gr = vec3(0.0);
    var squares = 0.0;
    var count = 0.0;
    var valid = 0.0;
    // Lanes of a workgroup take neighbouring pixels.
    var pixel = group.x * LANES * PIXELS + lane;
    for (var i = 0u; i < PIXELS; i++) {
        if pixel < pixels {
            let p = pair(pixel);
            let t = p.translation;
            let r = p.rotation;
            tt0 += t.x * t;
            tt1 += vec3(t.y * t.yz, t.z * t.z);
            tr0 += t.x * r;
            tr1 += t.y * r;
            tr2 += t.z * r;
            rr0 += r.x * r;
            rr1 += vec3(r.y * r.yz, r.z * r.z);
            gt += t * p.residual;
            gr += r * p.residual;
            squares += p.residual * p.residual;
            count += p.count;
            valid += p.valid;
        }
        pixel += LANES;
    }
    // The upper triangle row by row, then the gradient, the squares, the count.
    let out = row * 32u;
    partial_sums[out + 0u] = tt0.x;
    partial_sums[out + 1u] = tt0.y;
    partial_sums[out + 2u] = tt0.z;
    partial_sums[out + 3u] = tr0.x;
    partial_sums[out + 4u] = tr0.y;
    partial_sums[out + 5u] = tr0.z;
    partial_sums[out + 6u] = tt1.x;
    partial_sums[out + 7u] = tt1.y;
    partial_sums[out + 8u] = tr1.x;
    partial_sums[out + 9u] = tr1.y;
    partial_sums[out + 10u] = tr1.z;
    partial_sums[out + 11u] = tt1.z;
    partial_sums[out + 12u] = tr2.x;
    partial_sums[out + 13u] = tr2.y;
    partial_sums[out + 14u] = tr2.z;
    partial_sums[out + 15u] = rr0.x;
    partial_sums[out + 16u] = rr0.y;
    partial_sums[out + 17u] = rr0.z;
    partial_sums[out + 18u] = rr1.x;
    partial_sums[out + 19u] = rr1.y;
    partial_sums[out + 20u] = rr1.z;
    partial_sums[out + 21u] = gt.x;
    partial_sums[out + 22u] = gt.y;
    partial_sums[out + 23u] = gt.z;
    partial_sums[out + 24u] = gr.x;
    partial_sums[out + 25u] = gr.y;
    partial_sums[out + 26u] = gr.z;
    partial_sums[out + 27u] = squares;
    partial_sums[out + 28u] = count;
    partial_sums[out + 29u] = valid;
}
