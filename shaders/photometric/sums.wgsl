// The difference in colour between surface points and the live image (the report, sections 3.1.2 and 3.1.3; Whelan et al.
// 2014, section 3.2; Steinbrücker et al. 2011): each point of a list is projected into the colour image, where its own
// colour, taken through a gain and an offset, is expected. An invocation sums over many points and writes a row of COLUMNS
// numbers. No barrier, and always the same order of additions.
import package::shared::camera::{Camera, project};
import package::shared::weights::weight_by_depth;

struct Params {
    // The colour image's level.
    camera: Camera,
    camera_from_world: mat4x4<f32>,
    // See `icp`.
    pivot: vec3<f32>,
    // Differences as large as this no longer count (Tukey's biweight; Beaton & Tukey 1974).
    cutoff: f32,
    // What a point's colour is multiplied by, and what is added, before it is compared.
    gain: f32,
    offset: f32,
    // Smallest change of the image from pixel to pixel that says something about the pose.
    least_gradient: f32,
    // How a point's weight follows its depth.
    depth_weight: u32,
    points: u32,
    rows: u32,
    unused: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
// World coordinates (bits of floats), and the colour as four bytes; the last one is 0 where there is no point.
@group(0) @binding(1) var<storage, read> list: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read> image: array<u32>;
@group(0) @binding(3) var<storage, read_write> partial_sums: array<f32>;

override LANES: u32 = 64u;
// Points that an invocation sums up.
override PIXELS: u32 = 16u;

const COLUMNS: u32 = 50u;

fn texel(x: u32, y: u32) -> vec4<f32> {
    return unpack4x8unorm(image[y * params.camera.size.x + x]);
}

// Colour at a place between pixels, and its derivatives along x and y. The fourth number is 1 where all four pixels are there.
struct Sample {
    value: vec4<f32>,
    along_x: vec3<f32>,
    along_y: vec3<f32>,
}

fn sample(pixel: vec2<f32>) -> Sample {
    let last = params.camera.size - vec2(1u);
    let base = min(vec2<u32>(pixel), last);
    let next = min(base + vec2(1u), last);
    let f = pixel - vec2<f32>(base);
    let a = texel(base.x, base.y);
    let b = texel(next.x, base.y);
    let c = texel(base.x, next.y);
    let d = texel(next.x, next.y);
    let whole = f32(min(min(a.w, b.w), min(c.w, d.w)) > 0.0);
    return Sample(
        vec4(mix(mix(a.rgb, b.rgb, f.x), mix(c.rgb, d.rgb, f.x), f.y), whole),
        mix(b.rgb - a.rgb, d.rgb - c.rgb, f.y),
        mix(c.rgb - a.rgb, d.rgb - b.rgb, f.x),
    );
}

// The upper triangle of JᵀWJ row by row for translation, rotation, gain and offset, and JᵀWr.
struct Sums {
    h0: vec4<f32>,
    h1: vec4<f32>,
    h2: vec4<f32>,
    h3: vec3<f32>,
    h4: vec4<f32>,
    h5: vec2<f32>,
    h6: vec4<f32>,
    h7: f32,
    h8: vec4<f32>,
    h9: vec3<f32>,
    h10: vec2<f32>,
    h11: f32,
    by_translation: vec3<f32>,
    by_rotation: vec3<f32>,
    by_gain: f32,
    by_offset: f32,
}

// Adds one difference between the value `a` expected of a point, which lies at `p` before the camera, and the image, which
// changes by `along` for each metre that the point moves sideways.
fn add(sums: ptr<function, Sums>, w: f32, p: vec3<f32>, point: vec3<f32>, along: vec2<f32>, a: f32, residual: f32) {
    let to_world = mat3x3<f32>(
        params.camera_from_world[0].xyz,
        params.camera_from_world[1].xyz,
        params.camera_from_world[2].xyz,
    );
    // The camera's motion moves the point the other way, and the image's value counts negatively.
    let t = vec3(along, -dot(along, p.xy) / max(p.z, 1e-3)) * to_world;
    let r = cross(point - params.pivot, t);
    (*sums).h0 += w * t.x * vec4(t.x, t.y, t.z, r.x);
    (*sums).h1 += w * t.x * vec4(r.y, r.z, a, 1.0);
    (*sums).h2 += w * t.y * vec4(t.y, t.z, r.x, r.y);
    (*sums).h3 += w * t.y * vec3(r.z, a, 1.0);
    (*sums).h4 += w * t.z * vec4(t.z, r.x, r.y, r.z);
    (*sums).h5 += w * t.z * vec2(a, 1.0);
    (*sums).h6 += w * r.x * vec4(r.x, r.y, r.z, a);
    (*sums).h7 += w * r.x;
    (*sums).h8 += w * r.y * vec4(r.y, r.z, a, 1.0);
    (*sums).h9 += w * r.z * vec3(r.z, a, 1.0);
    (*sums).h10 += w * a * vec2(a, 1.0);
    (*sums).h11 += w * 1.0;
    (*sums).by_translation += w * residual * t;
    (*sums).by_rotation += w * residual * r;
    (*sums).by_gain += w * residual * a;
    (*sums).by_offset += w * residual;
}

const LUMA: vec3<f32> = vec3(0.299, 0.587, 0.114);

@compute @workgroup_size(LANES)
fn main(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3<u32>) {
    let row = group.x * LANES + lane;
    if row >= params.rows {
        return;
    }
    var sums = Sums();
    var cost = 0.0;
    var weights = 0.0;
    var unseen = 0.0;
    var squares = 0.0;
    var count = 0.0;
    var valid = 0.0;
    var i = group.x * LANES * PIXELS + lane;
    for (var k = 0u; k < PIXELS; k++) {
        let in_list = i < params.points;
        let entry = list[select(0u, i, in_list)];
        let point = bitcast<vec3<f32>>(entry.xyz);
        let expected = unpack4x8unorm(entry.w);
        if in_list && expected.w > 0.0 {
            let p = (params.camera_from_world * vec4(point, 1.0)).xyz;
            let weight = weight_by_depth(params.depth_weight, params.camera.depth_range, p.z);
            let pixel = project(params.camera, vec3(p.xy, max(p.z, 1e-3)));
            let last = vec2<f32>(params.camera.size - vec2(1u));
            let seen = p.z > 1e-3 && all(pixel >= vec2(0.0)) && all(pixel <= last);
            let live = sample(clamp(pixel, vec2(0.0), last));
            // Pixels a metre of sideways motion, over the depth.
            let scale = params.camera.focal / max(p.z, 1e-3);
            var pair = f32(seen) * live.value.w;
            @if(!rgb) let a = dot(expected.rgb, LUMA);
            @if(!rgb) let residual = params.gain * a + params.offset - dot(live.value.rgb, LUMA);
            @if(!rgb) let gradient = vec2(dot(live.along_x, LUMA), dot(live.along_y, LUMA));
            @if(!rgb) let square = residual * residual;
            @if(rgb) let differences = params.gain * expected.rgb + params.offset - live.value.rgb;
            @if(rgb) let gradient = vec2(length(live.along_x), length(live.along_y));
            @if(rgb) let square = dot(differences, differences);
            pair *= f32(dot(gradient, gradient) >= params.least_gradient * params.least_gradient);
            let rest = max(1.0 - square / (params.cutoff * params.cutoff), 0.0);
            let largest = params.cutoff * params.cutoff / 6.0;
            let w = weight * pair * rest * rest;
            let inlier = pair * f32(rest > 0.0);
            cost += weight * pair * largest * (1.0 - rest * rest * rest);
            weights += weight * pair;
            unseen += weight * (1.0 - pair);
            squares += inlier * square;
            count += inlier;
            valid += 1.0;
            @if(!rgb) add(&sums, w, p, point, gradient * scale, a, residual);
            @if(rgb) {
                for (var c = 0u; c < 3u; c++) {
                    let along = vec2(live.along_x[c], live.along_y[c]) * scale;
                    add(&sums, w, p, point, along, expected[c], differences[c]);
                }
            }
        }
        i += LANES;
    }
    let out = row * COLUMNS;
    // What the host names in its own list.
    partial_sums[out + 0u] = sums.h0.x;
    partial_sums[out + 1u] = sums.h0.y;
    partial_sums[out + 2u] = sums.h0.z;
    partial_sums[out + 3u] = sums.h0.w;
    partial_sums[out + 4u] = sums.h1.x;
    partial_sums[out + 5u] = sums.h1.y;
    partial_sums[out + 6u] = sums.h1.z;
    partial_sums[out + 7u] = sums.h1.w;
    partial_sums[out + 8u] = sums.h2.x;
    partial_sums[out + 9u] = sums.h2.y;
    partial_sums[out + 10u] = sums.h2.z;
    partial_sums[out + 11u] = sums.h2.w;
    partial_sums[out + 12u] = sums.h3.x;
    partial_sums[out + 13u] = sums.h3.y;
    partial_sums[out + 14u] = sums.h3.z;
    partial_sums[out + 15u] = sums.h4.x;
    partial_sums[out + 16u] = sums.h4.y;
    partial_sums[out + 17u] = sums.h4.z;
    partial_sums[out + 18u] = sums.h4.w;
    partial_sums[out + 19u] = sums.h5.x;
    partial_sums[out + 20u] = sums.h5.y;
    partial_sums[out + 21u] = sums.h6.x;
    partial_sums[out + 22u] = sums.h6.y;
    partial_sums[out + 23u] = sums.h6.z;
    partial_sums[out + 24u] = sums.h6.w;
    partial_sums[out + 25u] = sums.h7;
    partial_sums[out + 26u] = sums.h8.x;
    partial_sums[out + 27u] = sums.h8.y;
    partial_sums[out + 28u] = sums.h8.z;
    partial_sums[out + 29u] = sums.h8.w;
    partial_sums[out + 30u] = sums.h9.x;
    partial_sums[out + 31u] = sums.h9.y;
    partial_sums[out + 32u] = sums.h9.z;
    partial_sums[out + 33u] = sums.h10.x;
    partial_sums[out + 34u] = sums.h10.y;
    partial_sums[out + 35u] = sums.h11;
    partial_sums[out + 36u] = sums.by_translation.x;
    partial_sums[out + 37u] = sums.by_translation.y;
    partial_sums[out + 38u] = sums.by_translation.z;
    partial_sums[out + 39u] = sums.by_rotation.x;
    partial_sums[out + 40u] = sums.by_rotation.y;
    partial_sums[out + 41u] = sums.by_rotation.z;
    partial_sums[out + 42u] = sums.by_gain;
    partial_sums[out + 43u] = sums.by_offset;
    partial_sums[out + 44u] = cost;
    partial_sums[out + 45u] = weights;
    partial_sums[out + 46u] = unseen;
    partial_sums[out + 47u] = squares;
    partial_sums[out + 48u] = count;
    partial_sums[out + 49u] = valid;
}
