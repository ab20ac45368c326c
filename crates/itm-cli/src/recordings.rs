//! How recordings are opened, by all commands that do.

use std::path::PathBuf;
use std::str::FromStr;

use clap::Args;
use itm_io::recording::{Format, OpenOptions, Topics};

/// What a command line says of a recording besides its path.
#[derive(Args)]
pub(crate) struct RecordingArguments {
    /// Calibration file, in place of the recording's own
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Format of the recording, where it is not recognised: tum, icl-nuim, 7-scenes, mcap or images
    #[arg(long, value_parser = Format::from_str)]
    format: Option<Format>,
    /// Depth images within the folder, with a number or *: 'depth/%06d.png'
    #[arg(long, value_name = "PATTERN")]
    depth_pattern: Option<String>,
    /// Colour images, likewise
    #[arg(long, value_name = "PATTERN", alias = "color-pattern")]
    colour_pattern: Option<String>,
    /// Orientations of an inertial sensor, likewise: files with the nine numbers of a rotation matrix
    #[arg(long, value_name = "PATTERN")]
    pub(crate) imu_pattern: Option<String>,
    /// Topics of an MCAP file, where its messages do not tell: depth=/a,color=/b,depth_info=/c,color_info=/d,pose=/e,imu=/f,
    /// each where it is needed; color, pose and imu may be none
    #[arg(long, value_name = "NAME=TOPIC,…", value_parser = Topics::from_str)]
    topics: Option<Topics>,
}

impl RecordingArguments {
    pub(crate) fn options(&self) -> OpenOptions {
        OpenOptions {
            format: self.format,
            calibration: self.calibration.clone(),
            depth_pattern: self.depth_pattern.clone(),
            colour_pattern: self.colour_pattern.clone(),
            imu_pattern: self.imu_pattern.clone(),
            topics: self.topics.clone().unwrap_or_default(),
        }
    }
}
