// How many of each 32 pixels become surfels, from their bits, which lie behind the counts.

struct Params {
    chunks: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> wanted: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var chunk = id.x; chunk < params.chunks; chunk += groups.x * 64u) {
        wanted[chunk] = countOneBits(wanted[params.chunks + chunk]);
    }
}
