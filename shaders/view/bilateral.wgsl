// One 5x5 pass of a bilateral filter over depth (Tomasi & Manduchi 1998). The range kernel's width is a Kinect's axial
// noise at the centre's depth, 0.0012 + 0.0019 (z - 0.4)^2 metres (Nguyen et al. 2012).

struct Params {
    size: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> depth: array<f32>;
@group(0) @binding(2) var<storage, read_write> filtered: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id.xy >= params.size) {
        return;
    }
    let at = id.y * params.size.x + id.x;
    let z = depth[at];
    if z <= 0.0 {
        filtered[at] = 0.0;
        return;
    }
    let sigma = 0.0012 + 0.0019 * (z - 0.4) * (z - 0.4);
    let per_variance = 0.5 / (sigma * sigma);
    var sum = 0.0;
    var weights = 0.0;
    for (var dy = -2; dy <= 2; dy++) {
        for (var dx = -2; dx <= 2; dx++) {
            let p = vec2<i32>(id.xy) + vec2(dx, dy);
            if all(p >= vec2(0)) && all(p < vec2<i32>(params.size)) {
                let other = depth[u32(p.y) * params.size.x + u32(p.x)];
                if other > 0.0 {
                    // Spatial kernel: one pixel wide.
                    let d = other - z;
                    let w = exp(-0.5 * f32(dx * dx + dy * dy) - d * d * per_variance);
                    sum += w * other;
                    weights += w;
                }
            }
        }
    }
    filtered[at] = sum / weights;
}
