// What each cell of the finest level shows: a place with a normal, and whether most of its measurements stand well in front of the
// stable surface that was seen there from the pose before, or see through something (Keller et al. 2013, section on dynamics: the
// points that have no correspondence).
import package::shared::camera::{Camera, project};
import package::shared::cells::{DYNAMIC, VACANT, PARTLY_VACANT};
import package::shared::surfel::depth_deviation;

struct Params {
    camera: Camera,
    // From this view's camera, and from the world, to the camera that saw the model.
    model_from_camera: mat4x4<f32>,
    model_from_world: mat4x4<f32>,
    // Cells, and pixels to a cell's side.
    size: vec2<u32>,
    side: u32,
    // In front of the model from here on: metres, and standard deviations more.
    gate_m: f32,
    gate_deviations: f32,
    // Of the model's confidence.
    stable: f32,
    // Of a cell's measurements.
    least_share: f32,
    // Measurements belong to what the cell shows up to this distance from its plane: metres, and standard deviations more.
    alike_m: f32,
    alike_deviations: f32,
    unused_a: u32,
    unused_b: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> vertices: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> normals: array<vec4<f32>>;
// World frame, and one plus the confidence.
@group(0) @binding(3) var<storage, read> model: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> vacant: array<u32>;
@group(0) @binding(5) var<storage, read_write> places: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> facings: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> marks: array<u32>;

fn is_in_front(vertex: vec3<f32>) -> bool {
    let seen = (params.model_from_camera * vec4(vertex, 1.0)).xyz;
    if seen.z <= 0.0 {
        return false;
    }
    let pixel = floor(project(params.camera, seen) + 0.5);
    if any(pixel < vec2(0.0)) || any(pixel >= vec2<f32>(params.camera.size)) {
        return false;
    }
    let behind = model[u32(pixel.y) * params.camera.size.x + u32(pixel.x)];
    let z = (params.model_from_world * vec4(behind.xyz, 1.0)).z;
    return behind.w - 1.0 >= params.stable
        && z - seen.z > params.gate_m + params.gate_deviations * depth_deviation(z);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let width = params.camera.size.x;
    for (var i = id.x; i < params.size.x * params.size.y; i += groups.x * 64u) {
        let first = vec2(i % params.size.x, i / params.size.x) * params.side;
        let last = min(first + vec2(params.side), params.camera.size);
        let middle = min(first + vec2(params.side / 2u), params.camera.size - vec2(1u));
        // The middle's, or else the first there is.
        var shown = middle.y * width + middle.x;
        for (var y = first.y; y < last.y && normals[shown].w == 0.0; y++) {
            for (var x = first.x; x < last.x && normals[shown].w == 0.0; x++) {
                shown = y * width + x;
            }
        }
        let place = vertices[shown].xyz;
        let facing = normals[shown];
        let most_m = params.alike_m + params.alike_deviations * depth_deviation(place.z);
        var measured = 0u;
        var in_front = 0u;
        var through = 0u;
        for (var y = first.y; y < last.y; y++) {
            for (var x = first.x; x < last.x; x++) {
                let at = y * width + x;
                let vertex = vertices[at];
                if vertex.w == 0.0 {
                    continue;
                }
                measured += 1u;
                through += vacant[at];
                // What moves is to be what the cell shows, or it would grow over what is behind.
                if facing.w > 0.0 && abs(dot(facing.xyz, vertex.xyz - place)) <= most_m {
                    in_front += u32(is_in_front(vertex.xyz));
                }
            }
        }
        let least = max(params.least_share * f32(measured), 1.0);
        var found = select(0u, PARTLY_VACANT, through > 0u);
        found |= select(0u, VACANT, f32(through) >= least);
        found |= select(0u, DYNAMIC, f32(in_front) >= least);
        places[i] = select(vec4(0.0), vertices[shown], facing.w > 0.0);
        facings[i] = facing;
        marks[i] = found;
    }
}
