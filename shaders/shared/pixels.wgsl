// A list of pixels: three words of an indirect dispatch, their number, and where they begin.
const COUNT: u32 = 3u;
const FIRST: u32 = 4u;
