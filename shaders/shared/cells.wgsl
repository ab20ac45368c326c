// Cells of an image: what `segment` knows of squares of pixels.

// A cell's marks. What is measured there moves, or is new …
const DYNAMIC: u32 = 1u;
// … and what was there has left: most of the cell is seen through, …
const VACANT: u32 = 2u;
// … or some of it, which is enough beside a cell of which most is.
const PARTLY_VACANT: u32 = 4u;

// Whether two places (camera frame, metres; zero in the fourth number where there is none) are of one smooth surface: each lies near
// the other's plane, and their normals are alike.
fn is_alike(a: vec4<f32>, normal_a: vec4<f32>, b: vec4<f32>, normal_b: vec4<f32>, most_m: f32, least_cosine: f32) -> bool {
    let off = b.xyz - a.xyz;
    let is_near = abs(dot(off, normal_a.xyz)) <= most_m && abs(dot(off, normal_b.xyz)) <= most_m;
    return a.w > 0.0 && b.w > 0.0 && is_near && dot(normal_a.xyz, normal_b.xyz) >= least_cosine;
}
