// Which surfel of one page each pixel's measurement belongs to, and which of those that competed with it is to be merged with it: the
// first of several stable ones. What stands in front of a well-known surface that is seen stands in free space, and is removed
// (Keller et al. 2013, section 5.3), and so is what stays unstable though it is looked at.
import package::shared::span::span;
import package::shared::surfel::{SEEN, REMOVED, IN_FRONT, OLD, PREFERRED, REFUTED, pixel_of, place_of, rank_of, rank_of_key};

struct Params {
    room: u32,
    first: u32,
    page: u32,
    stable: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> counters: array<atomic<u32>>;
@group(0) @binding(2) var<storage, read> listed: array<u32>;
@group(0) @binding(3) var<storage, read> targets: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read> best: array<u32>;
// The complements of surfels' indices; zeroed memory has none.
@group(0) @binding(5) var<storage, read_write> chosen: array<u32>;
@group(0) @binding(6) var<storage, read_write> rivals: array<atomic<u32>>;
@group(0) @binding(7) var<storage, read_write> places: array<vec4<f32>>;

// Few on software drivers, whose invocations then read what lies next to each other.
override LANES: u32 = 64u;

@compute @workgroup_size(LANES)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let part = span(min(atomicLoad(&counters[SEEN]), params.room), group.x, groups.x);
    for (var i = part.x + lane; i < part.y; i += LANES) {
        let goal = targets[i].x;
        let index = listed[i];
        if goal == 0u || index < params.first || index - params.first >= params.page {
            continue;
        }
        let pixel = pixel_of(goal);
        let competes = (goal & (IN_FRONT | REFUTED)) == 0u;
        let is_free = (goal & IN_FRONT) != 0u && best[pixel] != 0u && rank_of_key(best[pixel]) >= rank_of(params.stable);
        if competes && place_of(best[pixel]) == i {
            chosen[pixel] = ~index;
        } else if is_free || (goal & OLD) != 0u {
            places[index - params.first] = vec4(0.0);
            atomicAdd(&counters[REMOVED], 1u);
        } else if competes && (targets[i].y & PREFERRED) != 0u {
            atomicMax(&rivals[pixel], ~index);
        }
    }
}
