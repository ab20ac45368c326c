// Which surfel each cell keeps: of those within a window behind the nearest the best known. The others' discs would show next to
// nothing: there is a better one in their place.
import package::shared::span::span;
import package::shared::surfel::{SEEN, PREFERRED, depth_of, depth_of_mark, key_of_rank, last_depth, rank_of_mark};

struct Params {
    room: u32,
    // Depth behind the nearest: metres, and standard deviations more.
    window_m: f32,
    window_deviations: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> targets: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> front: array<u32>;
// Keys of surfels; zeroed memory has none.
@group(0) @binding(4) var<storage, read_write> kept: array<atomic<u32>>;

// Few on software drivers, whose invocations then read what lies next to each other.
override LANES: u32 = 64u;

@compute @workgroup_size(LANES)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let part = span(min(counters[SEEN], params.room), group.x, groups.x);
    for (var i = part.x + lane; i < part.y; i += LANES) {
        let goal = targets[i];
        if goal.x == 0u {
            continue;
        }
        let cell = goal.x - 1u;
        let mark = goal.y;
        let nearest = front[cell];
        let last_z = last_depth(depth_of(nearest), params.window_m, params.window_deviations);
        // Both are preferred, or neither.
        if ((nearest ^ mark) & PREFERRED) == 0u && depth_of_mark(mark) <= last_z {
            atomicMax(&kept[cell], key_of_rank(rank_of_mark(mark), i));
        }
    }
}
