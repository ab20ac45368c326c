// Where each visible block lies in the range image (one pixel for 8x8 of the view) and how near and far it reaches,
// and into how many fragments of 16x16 range pixels its bounding box falls (the report, section 3.4).
import package::shared::camera::{Camera, project};
import package::shared::map::{Map, VISIBLE, unpack_position};

struct Params {
    camera: Camera,
    camera_from_world: mat4x4<f32>,
    map: Map,
    range_size: vec2<u32>,
    capacity: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> visible: array<u32>;
@group(0) @binding(3) var<storage, read> keys: array<vec2<u32>>;
// First and last range pixel (x | y << 16), near and far depth as bits.
@group(0) @binding(4) var<storage, read_write> boxes: array<vec4<u32>>;
@group(0) @binding(5) var<storage, read_write> counts: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < params.capacity; i += groups.x * 64u) {
        if i >= counters[VISIBLE] {
            // The scan runs over all of the list's room.
            counts[i] = 0u;
            continue;
        }
        let corner = vec3<f32>(unpack_position(keys[visible[i]])) * 8.0 * params.map.voxel_size_m;
        // The block's cells: its last voxels reach up to the next block's first.
        let side = 8.0 * params.map.voxel_size_m;
        let base = (params.camera_from_world * vec4(corner, 1.0)).xyz;
        var lower = vec2(3e38);
        var upper = vec2(-3e38);
        var near = 3e38;
        var far = -3e38;
        for (var c = 0u; c < 8u; c++) {
            let offset = vec3<f32>(vec3(c & 1u, (c >> 1u) & 1u, c >> 2u)) * side;
            let p = base + (params.camera_from_world * vec4(offset, 0.0)).xyz;
            near = min(near, p.z);
            far = max(far, p.z);
            let pixel = project(params.camera, vec3(p.xy, max(p.z, 1e-3)));
            lower = min(lower, pixel);
            upper = max(upper, pixel);
        }
        if near < 1e-3 {
            // A block that reaches behind the camera's plane may appear anywhere: where its edges cross that plane, they
            // go to infinity, which the corners' pixels do not bound.
            lower = vec2(-3e38);
            upper = vec2(3e38);
        }
        let last = vec2<f32>(params.range_size) - 1.0;
        // The block may be seen by a ray through any point of a pixel's square.
        let first_pixel = floor((lower - 0.5) / 8.0);
        let last_pixel = floor((upper + 1.5) / 8.0);
        if any(last_pixel < vec2(0.0)) || any(first_pixel > last) || far <= 0.0 {
            counts[i] = 0u;
            continue;
        }
        let a = vec2<u32>(clamp(first_pixel, vec2(0.0), last));
        let b = vec2<u32>(clamp(last_pixel, vec2(0.0), last));
        boxes[i] = vec4(
            a.x | (a.y << 16u),
            b.x | (b.y << 16u),
            bitcast<u32>(max(near, 1e-6)),
            bitcast<u32>(far),
        );
        let fragments = (b - a) / 16u + vec2(1u);
        counts[i] = fragments.x * fragments.y;
    }
}
