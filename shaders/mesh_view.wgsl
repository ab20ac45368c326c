// Rasterises a part of a triangle mesh: colours as of a raycast image (see `render/shade.wgsl`), and depth. Both sides of its
// triangles are shown.
import package::shared::shading::{COLOUR, CONFIDENCE, DEPTH, NORMALS, lit, on_scale};

struct Params {
    // The rows of the rotation from the frame of the world to that of the camera.
    turn_x: vec4<f32>,
    turn_y: vec4<f32>,
    turn_z: vec4<f32>,
    // The camera's centre (world, metres).
    camera: vec4<f32>,
    // Focal lengths, and the principal point counted from the upper left corner of the image, not from the centre of its first
    // pixel; in pixels.
    focal: vec2<f32>,
    centre: vec2<f32>,
    // Width and height in pixels.
    size: vec2<f32>,
    // Nearest and farthest depth that is shown, in metres.
    depth_range: vec2<f32>,
    // The values at the scale's ends: metres, or observations.
    range: vec2<f32>,
    // As `shared/shading.wgsl` numbers it.
    kind: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
// Two a vertex: its position (world, metres) as bits of floats and its colour, red from the lowest byte up; its unit normal
// (world), zero where unknown, and its confidence, as bits of floats.
@group(0) @binding(1) var<storage, read> vertices: array<vec4<u32>>;

struct Seen {
    @builtin(position) clip: vec4<f32>,
    // From the camera's centre (world, metres).
    @location(0) offset: vec3<f32>,
    @location(1) normal: vec3<f32>,
    @location(2) colour: vec3<f32>,
    // Depth along the optical axis in metres, and confidence.
    @location(3) values: vec2<f32>,
}

struct Pixel {
    @location(0) colour: vec4<f32>,
    @location(1) depth: f32,
}

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> Seen {
    let first = vertices[2u * index];
    let second = vertices[2u * index + 1u];
    let offset = bitcast<vec3<f32>>(first.xyz) - params.camera.xyz;
    let seen = vec3(dot(params.turn_x.xyz, offset), dot(params.turn_y.xyz, offset), dot(params.turn_z.xyz, offset));
    // Where in the image, times depth: from 0 to its size. A clip space goes from -1 to 1, upwards.
    let place = params.focal * seen.xy + params.centre * seen.z;
    let across = 2.0 * place / params.size - seen.z;
    let near = params.depth_range.x;
    let far = params.depth_range.y;
    // 1 at the nearest and 0 at the farthest depth: a float is finest near 0, where depths lie close together.
    let nearness = near * (far - seen.z) / (far - near);
    let clip = vec4(across.x, -across.y, nearness, seen.z);
    let normal = bitcast<vec3<f32>>(second.xyz);
    return Seen(clip, offset, normal, unpack4x8unorm(first.w).rgb, vec2(seen.z, bitcast<f32>(second.w)));
}

@fragment
fn fragment(seen: Seen) -> Pixel {
    return Pixel(vec4(colour_of(seen), 1.0), seen.values.x);
}

fn colour_of(seen: Seen) -> vec3<f32> {
    if params.kind == DEPTH {
        return on_scale(seen.values.x, params.range);
    }
    if params.kind == CONFIDENCE {
        return on_scale(seen.values.y, params.range);
    }
    if params.kind == COLOUR {
        return seen.colour;
    }
    let normal = seen.normal / max(length(seen.normal), 1e-9);
    if params.kind == NORMALS {
        return 0.5 + 0.5 * normal;
    }
    return lit(params.kind, dot(normal, normalize(seen.offset)));
}
