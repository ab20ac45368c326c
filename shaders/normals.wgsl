// Normals of a raycast image from neighbouring points: two pixels apart, or one where that would reach over an edge of
// more than 0.15 m (world frame, unit length, towards the camera; w is 1, or 0 where there is none).

struct Params {
    size: vec2<u32>,
    unused: vec2<u32>,
    // The camera's centre (world frame).
    camera: vec4<f32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> points: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> normals: array<vec4<f32>>;

// The vector between the points `reach` pixels before and behind along an axis; w is 0 where there is no such pair.
fn difference(pixel: vec2<i32>, axis: vec2<i32>, reach: i32) -> vec4<f32> {
    let a = pixel - axis * reach;
    let b = pixel + axis * reach;
    let size = vec2<i32>(params.size);
    if any(a < vec2(0)) || any(b >= size) {
        return vec4(0.0);
    }
    let p = points[a.y * size.x + a.x];
    let q = points[b.y * size.x + b.x];
    if p.w == 0.0 || q.w == 0.0 {
        return vec4(0.0);
    }
    return vec4(q.xyz - p.xyz, 1.0);
}

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id.xy >= params.size) {
        return;
    }
    let at = id.y * params.size.x + id.x;
    let point = points[at];
    var normal = vec4(0.0);
    if point.w > 0.0 {
        let pixel = vec2<i32>(id.xy);
        let limit = 0.15 * 0.15;
        var dx = difference(pixel, vec2(1, 0), 2);
        var dy = difference(pixel, vec2(0, 1), 2);
        if dx.w == 0.0 || dy.w == 0.0 || dot(dx.xyz, dx.xyz) > limit || dot(dy.xyz, dy.xyz) > limit {
            dx = difference(pixel, vec2(1, 0), 1);
            dy = difference(pixel, vec2(0, 1), 1);
        }
        if dx.w > 0.0 && dy.w > 0.0 {
            let n = cross(dx.xyz, dy.xyz);
            let l = length(n);
            if l > 1e-20 {
                let facing = select(1.0, -1.0, dot(n, params.camera.xyz - point.xyz) < 0.0);
                normal = vec4(n * (facing / l), 1.0);
            }
        }
    }
    normals[at] = normal;
}
