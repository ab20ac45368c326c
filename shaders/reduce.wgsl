// Sums rows of numbers into one, in a fixed order: four groups of 64 lanes each sum every fourth row, then the first group
// sums the four.

struct Params {
    rows: u32,
    // Numbers in a row, at most 64.
    columns: u32,
    // Where the sums go, in numbers from the start.
    to: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> partial_sums: array<f32>;
@group(0) @binding(2) var<storage, read_write> sums: array<f32>;

var<workgroup> shares: array<f32, 256>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) lane: u32) {
    let column = lane & 63u;
    var sum = 0.0;
    if column < params.columns {
        for (var row = lane >> 6u; row < params.rows; row += 4u) {
            sum += partial_sums[row * params.columns + column];
        }
    }
    shares[lane] = sum;
    workgroupBarrier();
    if lane < params.columns {
        sums[params.to + lane] = (shares[lane] + shares[lane + 64u]) + (shares[lane + 128u] + shares[lane + 192u]);
    }
}
