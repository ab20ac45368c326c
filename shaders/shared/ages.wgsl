// Ages in frames, sorted into bins that widen with the age: four to each power of two.

const AGE_BINS: u32 = 64u;

// The bin of an age of at least 1.
fn age_bin(age: u32) -> u32 {
    // Below 4 a bin an age, then the two bits behind the first one.
    let shift = max(firstLeadingBit(age), 2u) - 2u;
    return min(4u * shift + (age >> shift), AGE_BINS - 1u);
}
