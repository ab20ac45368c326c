// What each pixel shows of the discs of the cells around it: of those within a window behind the nearest, be it a large one, the best known.
import package::shared::camera::{Camera, unproject};
import package::shared::disc::{Disc, LEAST_FACING, OTHERS, rank_of_known};
import package::shared::surfel::{PREFERRED, depth_of, key_of_rank, last_depth, nearness_of};

struct Params {
    camera: Camera,
    // Cells of a row, and to each side of the image.
    width: u32,
    border: u32,
    // Depth behind the nearest: metres, and standard deviations more.
    window_m: f32,
    window_deviations: f32,
    // Pixels that meet no disc show discs that they meet within so many radii.
    fill: f32,
    unused_a: u32,
    unused_b: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> discs: array<Disc>;
// Nearness: of large discs before, and of all after.
@group(0) @binding(2) var<storage, read_write> nearest: array<u32>;
// Keys of cells by their surfels' ranks, or 0.
@group(0) @binding(3) var<storage, read_write> chosen: array<u32>;

// Rows of pixels that an invocation goes down, so that it reads each row of discs once. Few on GPUs, which want many invocations.
override STRIP: u32 = 4u;

const FAR: f32 = 1e30;

// Where a ray meets the planes of three discs: depths, distances from the discs' centres in radii, squared (`FAR` where a disc is not seen),
// and how well they are known.
struct Met {
    z: vec3<f32>,
    off: vec3<f32>,
    known: vec3<f32>,
}

// The discs of three cells side by side.
alias Row = array<Disc, 3>;

fn row_at(first: u32) -> Row {
    return Row(discs[first], discs[first + 1u], discs[first + 2u]);
}

fn meet(disc: Disc, ray: vec3<f32>) -> vec2<f32> {
    let cosine = dot(disc.normal, ray);
    let z = dot(disc.normal, disc.centre) / cosine;
    let off = ray * z - disc.centre;
    let faces = z > 0.0 && cosine < 0.0 && cosine * cosine >= LEAST_FACING * LEAST_FACING * dot(ray, ray);
    return vec2(z, select(FAR, dot(off, off) / (disc.radius * disc.radius), disc.radius > 0.0 && faces));
}

fn meet_row(row: Row, ray: vec3<f32>) -> Met {
    let a = meet(row[0], ray);
    let b = meet(row[1], ray);
    let c = meet(row[2], ray);
    return Met(vec3(a.x, b.x, c.x), vec3(a.y, b.y, c.y), vec3(row[0].known, row[1].known, row[2].known));
}

fn largest(v: vec3<f32>) -> f32 {
    return max(v.x, max(v.y, v.z));
}

// How well the best known of those is known that are met within a reach, and not behind a depth; 0 where there is none.
fn best(met: Met, reach: f32, last_z: f32) -> f32 {
    return largest(select(vec3(0.0), met.known, (met.off <= vec3(reach)) & (met.z <= vec3(last_z))));
}

// The nearest depth of those that are met within a reach and are preferred, or of the others.
fn nearest_of(met: Met, reach: f32, is_preferred: bool) -> f32 {
    let is_alike = (met.known > vec3(OTHERS)) == vec3(is_preferred);
    return -largest(select(vec3(-FAR), -met.z, (met.off <= vec3(reach)) & is_alike));
}

// The first of three that is met so and known as well, or 3.
fn place_of_best(met: Met, reach: f32, last_z: f32, known: f32) -> u32 {
    let is_it = (met.off <= vec3(reach)) & (met.z <= vec3(last_z)) & (met.known == vec3(known));
    return select(select(select(3u, 2u, is_it.z), 1u, is_it.y), 0u, is_it.x);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let size = params.camera.size;
    let strips = size.x * ((size.y + STRIP - 1u) / STRIP);
    for (var strip = id.x; strip < strips; strip += groups.x * 64u) {
        let x = strip % size.x;
        let top = strip / size.x * STRIP;
        // The cell above and to the left of the pixel.
        var first = (top + params.border - 1u) * params.width + x + params.border - 1u;
        var row_a = row_at(first);
        var row_b = row_at(first + params.width);
        for (var y = top; y < min(top + STRIP, size.y); y++) {
            let row_c = row_at(first + 2u * params.width);
            show(vec2(x, y), first, row_a, row_b, row_c);
            row_a = row_b;
            row_b = row_c;
            first += params.width;
        }
    }
}

fn show(pixel: vec2<u32>, first: u32, row_a: Row, row_b: Row, row_c: Row) {
    let i = pixel.y * params.camera.size.x + pixel.x;
    let ray = unproject(params.camera, vec2<f32>(pixel), 1.0);
    let above = meet_row(row_a, ray);
    let beside = meet_row(row_b, ray);
    let below = meet_row(row_c, ray);
    let large = nearest[i];
    var reach = 1.0;
    var most = max(best(above, reach, FAR), max(best(beside, reach, FAR), best(below, reach, FAR)));
    if most == 0.0 && large == 0u {
        reach = params.fill * params.fill;
        most = max(best(above, reach, FAR), max(best(beside, reach, FAR), best(below, reach, FAR)));
    }
    if most == 0.0 {
        chosen[i] = 0u;
        return;
    }
    let is_preferred = most > OTHERS || (large & PREFERRED) != 0u;
    var z = nearest_of(above, reach, is_preferred);
    z = min(z, min(nearest_of(beside, reach, is_preferred), nearest_of(below, reach, is_preferred)));
    if large != 0u && ((large & PREFERRED) != 0u) == is_preferred {
        z = min(z, depth_of(large));
    }
    nearest[i] = nearness_of(z, is_preferred);
    let last_z = last_depth(z, params.window_m, params.window_deviations);
    let known = max(best(above, reach, last_z), max(best(beside, reach, last_z), best(below, reach, last_z)));
    if known == 0.0 || (known > OTHERS) != is_preferred {
        chosen[i] = 0u;
        return;
    }
    let a = place_of_best(above, reach, last_z, known);
    let b = place_of_best(beside, reach, last_z, known);
    let c = place_of_best(below, reach, last_z, known);
    let cell = first + select(select(2u * params.width + c, params.width + b, b < 3u), a, a < 3u);
    chosen[i] = key_of_rank(rank_of_known(known), cell);
}
