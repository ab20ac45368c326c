// Measurements that lie on a disc of the surfels of the pixels around, of one page, do not become surfels. A disc that is much larger than
// what the pixel would become does not count: the surface is seen more finely now.
import package::shared::camera::Camera;
import package::shared::surfel::{Attributes, depth_deviation, unpack_normal, unpack_radius};

struct Params {
    camera: Camera,
    world_from_camera: mat4x4<f32>,
    first: u32,
    page: u32,
    chunks: u32,
    window_m: f32,
    window_deviations: f32,
    // Discs reach over so many of their radii.
    reach: f32,
    // A disc's radius is at most so many times that of the pixel's.
    finer: f32,
    // Radius of a pixel's disc at a depth of one metre.
    radius_per_m: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> vertices: array<vec4<f32>>;
// The complements of surfels' indices, or 0.
@group(0) @binding(2) var<storage, read> chosen: array<u32>;
// How many measurements have no surfel, and their pixels.
@group(0) @binding(3) var<storage, read> open: array<u32>;
@group(0) @binding(4) var<storage, read> places: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> attributes: array<Attributes>;
@group(0) @binding(6) var<storage, read_write> wanted: array<atomic<u32>>;

fn is_covered(i: u32, vertex: vec3<f32>) -> bool {
    let size = params.camera.size;
    let window = params.window_m + params.window_deviations * depth_deviation(vertex.z);
    let point = (params.world_from_camera * vec4(vertex, 1.0)).xyz;
    let x = i % size.x;
    let y = i / size.x;
    for (var v = max(y, 1u) - 1u; v < min(y + 2u, size.y); v++) {
        for (var u = max(x, 1u) - 1u; u < min(x + 2u, size.x); u++) {
            let other = chosen[v * size.x + u];
            let at = ~other - params.first;
            if other == 0u || ~other < params.first || at >= params.page {
                continue;
            }
            let own = attributes[at];
            let off = point - places[at].xyz;
            let along = dot(off, unpack_normal(own.x));
            let radius = unpack_radius(own.y);
            let is_fine = radius <= params.finer * params.radius_per_m * vertex.z;
            let reach = radius * params.reach;
            if is_fine && abs(along) <= window && dot(off, off) - along * along <= reach * reach {
                return true;
            }
        }
    }
    return false;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < open[0]; i += groups.x * 64u) {
        let pixel = open[i + 1u];
        if is_covered(pixel, vertices[pixel].xyz) {
            atomicAnd(&wanted[params.chunks + pixel / 32u], ~(1u << (pixel % 32u)));
        }
    }
}
