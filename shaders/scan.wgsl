// Exclusive prefix sum over `count` numbers, in place, by one workgroup. The total goes to `counters[total_slot]` and,
// divided by `divisor` and rounded up, into the indirect dispatch that starts at `indirect[indirect_slot]`.

struct Params {
    count: u32,
    total_slot: u32,
    indirect_slot: u32,
    divisor: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> values: array<u32>;
@group(0) @binding(2) var<storage, read_write> counters: array<u32>;
@group(0) @binding(3) var<storage, read_write> indirect: array<u32>;

const LANES: u32 = 256u;
var<workgroup> sums: array<u32, LANES>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) lane: u32) {
    // Each lane sums a contiguous share, the first lane scans the 256 sums, each lane writes its share.
    let share = (params.count + LANES - 1u) / LANES;
    let first = min(lane * share, params.count);
    let last = min(first + share, params.count);
    var sum = 0u;
    for (var i = first; i < last; i++) {
        sum += values[i];
    }
    sums[lane] = sum;
    workgroupBarrier();
    if lane == 0u {
        var running = 0u;
        for (var i = 0u; i < LANES; i++) {
            let value = sums[i];
            sums[i] = running;
            running += value;
        }
        counters[params.total_slot] = running;
        // A dispatch has at most 65535 workgroups; passes stride over what is beyond.
        indirect[params.indirect_slot] = min((running + params.divisor - 1u) / params.divisor, 65535u);
        indirect[params.indirect_slot + 1u] = 1u;
        indirect[params.indirect_slot + 2u] = 1u;
    }
    workgroupBarrier();
    var running = sums[lane];
    for (var i = first; i < last; i++) {
        let value = values[i];
        values[i] = running;
        running += value;
    }
}
