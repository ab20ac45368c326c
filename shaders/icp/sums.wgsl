// Point-to-plane alignment with projective association: each depth pixel against the surface that the model shows there
// (Newcombe et al. 2011, section 3.5; the report, sections 3.1.1 and 3.1.3). An invocation sums over many pixels and writes
// a row of COLUMNS numbers, listed where they are written. No barrier, and always the same order of additions.
import package::shared::camera::{Camera, unproject, project};
import package::shared::weights::weight_by_depth;

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
    // Points further apart are no pair.
    max_distance: f32,
    // Points further from the model's plane are no pair either.
    max_plane_distance: f32,
    // Residuals up to here count squared, larger ones linearly (Huber 1964).
    huber: f32,
    // How a pixel's weight follows its depth: one of shared/weights.wgsl's constants.
    depth_weight: u32,
    // Surface points count by their confidence, or by how often they were observed, up to this; 0 where all count alike.
    full_confidence: f32,
    // Surface points observed less often are no partners.
    least_confidence: f32,
    // Pixels skipped along both axes: every first, second, third … is used.
    stride: u32,
    rows: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> depth: array<f32>;
@group(0) @binding(2) var<storage, read> points: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> normals: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> partial_sums: array<f32>;

override LANES: u32 = 64u;
// Pixels that an invocation sums up.
override PIXELS: u32 = 16u;

const COLUMNS: u32 = 36u;

struct Pair {
    // Derivatives of the residual by translation and rotation.
    translation: vec3<f32>,
    rotation: vec3<f32>,
    residual: f32,
    // Of the pixel, whether it found a partner or not.
    weight: f32,
    // Of the pair; 0 for none, in which case the derivatives and the residual are 0 too.
    pair_weight: f32,
    // 1 where the measured point lies too far in front of the model's, or behind it.
    in_front: f32,
    behind: f32,
}

fn pair(pixel: vec2<u32>) -> Pair {
    let z = depth[pixel.y * params.depth_camera.size.x + pixel.x];
    let weight = select(0.0, weight_by_depth(params.depth_weight, params.depth_camera.depth_range, z), z > 0.0);
    let none = Pair(vec3(0.0), vec3(0.0), 0.0, weight, 0.0, 0.0, 0.0);
    // What does not count is neither measured nor a pair.
    if weight <= 0.0 {
        return none;
    }
    let world = (params.world_from_camera * vec4(unproject(params.depth_camera, vec2<f32>(pixel), z), 1.0)).xyz;
    let seen = (params.model_camera_from_world * vec4(world, 1.0)).xyz;
    if seen.z <= 0.0 {
        return none;
    }
    let where_seen = project(params.model_camera, seen) + 0.5;
    if any(where_seen < vec2(0.0)) || any(where_seen >= vec2<f32>(params.model_camera.size)) {
        return none;
    }
    let at = u32(where_seen.y) * params.model_camera.size.x + u32(where_seen.x);
    // The fourth number is how often the point was observed, plus one; 0 where there is none.
    let model = points[at];
    let normal = normals[at];
    if normal.w == 0.0 || model.w < params.least_confidence + 1.0 {
        return none;
    }
    let offset = world - model.xyz;
    let residual = dot(offset, normal.xyz);
    let square = dot(offset, offset);
    if square > params.max_distance * params.max_distance || abs(residual) > params.max_plane_distance {
        // Along the ray of the model's camera.
        let beyond = f32(dot(offset, params.pivot - world) < 0.0);
        return Pair(vec3(0.0), vec3(0.0), 0.0, weight, 0.0, 1.0 - beyond, beyond);
    }
    // The map's confidence, if it has one, or how often the point was observed.
    let observed = select(model.w - 1.0, normal.w - 2.0, normal.w >= 2.0);
    let confidence = select(1.0, min(observed / params.full_confidence, 1.0), params.full_confidence > 0.0);
    return Pair(normal.xyz, cross(world - params.pivot, normal.xyz), residual, weight, weight * confidence, 0.0, 0.0);
}

@compute @workgroup_size(LANES)
fn main(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3<u32>) {
    let size = (params.depth_camera.size + vec2(params.stride - 1u)) / params.stride;
    let pixels = size.x * size.y;
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
    var cost = 0.0;
    var weights = 0.0;
    var apart = 0.0;
    var unseen = 0.0;
    var squares = 0.0;
    var count = 0.0;
    var valid = 0.0;
    var in_front = 0.0;
    var behind = 0.0;
    // Lanes of a workgroup take neighbouring pixels.
    var pixel = group.x * LANES * PIXELS + lane;
    for (var i = 0u; i < PIXELS; i++) {
        if pixel < pixels {
            let p = pair(vec2(pixel % size.x, pixel / size.x) * params.stride);
            let size_of = abs(p.residual);
            let w = p.pair_weight * min(params.huber / max(size_of, 1e-12), 1.0);
            let t = w * p.translation;
            let r = w * p.rotation;
            tt0 += t.x * p.translation;
            tt1 += vec3(t.y * p.translation.yz, t.z * p.translation.z);
            tr0 += t.x * p.rotation;
            tr1 += t.y * p.rotation;
            tr2 += t.z * p.rotation;
            rr0 += r.x * p.rotation;
            rr1 += vec3(r.y * p.rotation.yz, r.z * p.rotation.z);
            gt += t * p.residual;
            gr += r * p.residual;
            let linear = params.huber * (size_of - 0.5 * params.huber);
            let is_pair = f32(p.pair_weight > 0.0);
            cost += p.pair_weight * select(0.5 * p.residual * p.residual, linear, size_of > params.huber);
            weights += p.pair_weight;
            let is_apart = p.in_front + p.behind;
            apart += p.weight * is_apart;
            unseen += p.weight * (1.0 - is_pair - is_apart);
            squares += p.residual * p.residual;
            count += is_pair;
            valid += f32(p.weight > 0.0);
            in_front += p.in_front;
            behind += p.behind;
        }
        pixel += LANES;
    }
    let out = row * COLUMNS;
    // The upper triangle of JᵀWJ row by row, JᵀWr, then what the host names in its own list.
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
    partial_sums[out + 27u] = cost;
    partial_sums[out + 28u] = weights;
    partial_sums[out + 29u] = apart;
    partial_sums[out + 30u] = squares;
    partial_sums[out + 31u] = count;
    partial_sums[out + 32u] = valid;
    partial_sums[out + 33u] = in_front;
    partial_sums[out + 34u] = behind;
    partial_sums[out + 35u] = unseen;
}
