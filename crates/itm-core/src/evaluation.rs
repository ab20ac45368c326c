//! How far a trajectory is from the truth: absolute trajectory error and relative pose error.
