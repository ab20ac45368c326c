// Where the surfels of one page that may be drawn have their centres, in cells of the size of pixels, and the nearest depth of each
// cell: of one that is known well enough, or, where there is none, of any other. Cells reach beyond the image, for discs that reach into it.
import package::shared::camera::{Camera, project};
import package::shared::disc::LEAST_FACING;
import package::shared::span::span;
import package::shared::surfel::{Attributes, SEEN, mark_of, nearness_of, submap_of, unpack_normal};

struct Params {
    camera: Camera,
    camera_from_world: mat4x4<f32>,
    first: u32,
    page: u32,
    room: u32,
    // Cells to each side of the image.
    border: u32,
    // Discs of at least this confidence hide all others.
    preferred: f32,
    // Discs of less are not drawn.
    least: f32,
    // Unstable ones that were seen last before this frame neither.
    since: u32,
    stable: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> listed: array<u32>;
@group(0) @binding(3) var<storage, read> places: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> attributes: array<Attributes>;
// One plus the cell of each listed surfel, or 0, and its mark.
@group(0) @binding(5) var<storage, read_write> targets: array<vec2<u32>>;
// The nearness of each cell's nearest.
@group(0) @binding(6) var<storage, read_write> front: array<atomic<u32>>;
@if(combined) @group(0) @binding(7) var<storage, read> camera_from_submaps: array<mat4x4<f32>>;

// Few on software drivers, whose invocations then read what lies next to each other.
override LANES: u32 = 64u;

@compute @workgroup_size(LANES)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let part = span(min(counters[SEEN], params.room), group.x, groups.x);
    let size = params.camera.size + 2u * params.border;
    for (var i = part.x + lane; i < part.y; i += LANES) {
        let index = listed[i];
        let at = index - params.first;
        if index < params.first || at >= params.page {
            continue;
        }
        let place = places[at];
        let own = attributes[at];
        @if(!combined) let camera_from_surfel = params.camera_from_world;
        @if(combined) let camera_from_surfel = camera_from_submaps[submap_of(own.y)];
        let centre = (camera_from_surfel * vec4(place.xyz, 1.0)).xyz;
        let facing = dot((camera_from_surfel * vec4(unpack_normal(own.x), 0.0)).xyz, centre);
        let cell = floor(project(params.camera, centre) + 0.5 + f32(params.border));
        // Since it was listed it may have been removed.
        let is_drawn = place.w > 0.0 && place.w >= params.least && (place.w >= params.stable || own.z >= params.since);
        let faces = facing < 0.0 && facing * facing >= LEAST_FACING * LEAST_FACING * dot(centre, centre);
        let is_near = centre.z > 0.0 && all(cell >= vec2(0.0)) && all(cell < vec2<f32>(size));
        var goal = vec2(0u);
        if is_drawn && faces && is_near {
            let to = u32(cell.y) * size.x + u32(cell.x);
            atomicMax(&front[to], nearness_of(centre.z, place.w >= params.preferred));
            goal = vec2(to + 1u, mark_of(centre.z, place.w, params.preferred));
        }
        targets[i] = goal;
    }
}
