// Sums rows of 32 numbers into one, in a fixed order: eight groups of 32 lanes each sum every eighth row, then the first
// group sums the eight.

struct Params {
    rows: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> partial_sums: array<f32>;
@group(0) @binding(2) var<storage, read_write> sums: array<f32>;

var<workgroup> shares: array<f32, 256>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) lane: u32) {
    let column = lane & 31u;
    var sum = 0.0;
    for (var row = lane >> 5u; row < params.rows; row += 8u) {
        sum += partial_sums[row * 32u + column];
    }
    shares[lane] = sum;
    workgroupBarrier();
    if lane < 32u {
        var total = 0.0;
        for (var i = 0u; i < 8u; i++) {
            total += shares[i * 32u + lane];
        }
        sums[lane] = total;
    }
}
