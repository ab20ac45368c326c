// Each measurement moves the surfel of one page that it belongs to, as one observation among those before it (Keller et al. 2013,
// section 4.2; the report's equation for surfels), and takes up the surfel that is to be merged with it.
import package::shared::camera::Camera;
import package::shared::observation::{radius_of, sample_confidence};
import package::shared::running_colour::with_colour;
import package::shared::surfel::{Attributes, UPDATED, MERGED, pack_normal, pack_size, submap_of, unpack_normal, unpack_radius};

struct Params {
    camera: Camera,
    world_from_camera: mat4x4<f32>,
    first: u32,
    page: u32,
    frame: u32,
    largest_confidence: f32,
    radius_per_m: f32,
    sigma: f32,
    // Where the pixel's disc is more than this many times as large, the surfel is only confirmed.
    coarser: f32,
    // Surfels this near, and with normals of at least this cosine, are one.
    merge_m: f32,
    merge_cosine: f32,
    unused_a: u32,
    unused_b: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> counters: array<atomic<u32>>;
@group(0) @binding(2) var<storage, read> vertices: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> normals: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> colours: array<u32>;
@group(0) @binding(5) var<storage, read> chosen: array<u32>;
@group(0) @binding(6) var<storage, read> rivals: array<u32>;
@group(0) @binding(7) var<storage, read_write> places: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> attributes: array<Attributes>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let width = params.camera.size.x;
    let pixels = width * params.camera.size.y;
    var updated = 0u;
    for (var i = id.x; i < pixels; i += groups.x * 64u) {
        let at = ~chosen[i] - params.first;
        if chosen[i] == 0u || ~chosen[i] < params.first || at >= params.page {
            continue;
        }
        updated += 1u;
        let vertex = vertices[i];
        let facing = normals[i].xyz;
        let before = places[at];
        let own = attributes[at];
        var place = before.xyz;
        var normal = unpack_normal(own.x);
        var radius = unpack_radius(own.y);
        let share = sample_confidence(params.camera, vec2(i % width, i / width), params.sigma);
        var confidence = before.w + share;
        let seen_radius = radius_of(params.radius_per_m, vertex.z, facing.z);
        if seen_radius <= params.coarser * radius {
            let part = share / confidence;
            place = mix(place, (params.world_from_camera * vec4(vertex.xyz, 1.0)).xyz, part);
            normal = mix(normal, (params.world_from_camera * vec4(facing, 0.0)).xyz, part);
            radius = mix(radius, seen_radius, part);
        }
        let rival = ~rivals[i] - params.first;
        if rivals[i] != 0u && ~rivals[i] >= params.first && rival < params.page {
            let other = places[rival];
            let off = other.xyz - place;
            let theirs = unpack_normal(attributes[rival].x);
            if dot(off, off) <= params.merge_m * params.merge_m && dot(theirs, normalize(normal)) >= params.merge_cosine {
                let part = other.w / (confidence + other.w);
                place = mix(place, other.xyz, part);
                normal = mix(normal, theirs, part);
                confidence += other.w;
                places[rival] = vec4(0.0);
                atomicAdd(&counters[MERGED], 1u);
            }
        }
        let l = length(normal);
        normal = select(unpack_normal(own.x), normal / l, l > 1e-6);
        places[at] = vec4(place, min(confidence, params.largest_confidence));
        var colour = own.w;
        if (colours[i] >> 24u) != 0u {
            colour = with_colour(colour, unpack4x8unorm(colours[i]).rgb * 255.0, 64u);
        }
        attributes[at] = vec4(pack_normal(normal), pack_size(radius, submap_of(own.y)), params.frame, colour);
    }
    if updated > 0u {
        atomicAdd(&counters[UPDATED], updated);
    }
}
