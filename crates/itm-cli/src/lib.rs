//! The `itm` program as a library, so that other front ends can be the same program.
//!
//! Results go to standard output; progress, warnings and errors go to standard error.

mod console;
mod convert;
mod devices;
mod eval;
mod info;
mod log;
mod maps;
mod mesh;
mod mesh_error;
mod pictures;
mod plot;
mod recordings;
mod render;
mod report;
mod results;
mod run;
mod settings;
mod summary;
mod synth;
mod timings;
mod view;

use std::ffi::OsString;

use clap::{Parser, Subcommand};

/// Dense RGB-D SLAM: reconstruct a recording of a depth camera into a coloured mesh and a trajectory.
#[derive(Parser)]
#[command(name = "itm", version, max_term_width = 100, after_help = EXAMPLES)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
    /// Say more on standard error; the environment variable RUST_LOG says precisely what
    #[arg(short, long, global = true)]
    verbose: bool,
}

#[derive(Subcommand)]
enum Command {
    Run(Box<run::Arguments>),
    Convert(Box<convert::Arguments>),
    Eval(eval::Arguments),
    Info(info::Arguments),
    Mesh(mesh::Arguments),
    Render(render::Arguments),
    Synth(synth::Arguments),
    View(Box<view::Arguments>),
    Devices(devices::Arguments),
}

const EXAMPLES: &str = "\
Examples:
  itm devices                         what can compute here
  itm synth room                      make a recording with exact ground truth
  itm run room                        reconstruct it into out/room
  itm view room                       the same in a window
  itm run rgbd_dataset_freiburg1_desk -o desk --set map.voxel_size_m=0.01
  itm convert room room.mcap          the recording as a file for robots' tools
  itm info room.itm                   what a saved map holds
  itm mesh room.itm -o room.ply       its surface; for views of it, itm render
  itm eval desk/trajectory.txt rgbd_dataset_freiburg1_desk/groundtruth.txt";

/// Runs the program with its command line, the program's own name first, and returns the exit status: 0 when all went
/// well, 1 after an error, 2 where the command line cannot be understood, 130 when Ctrl-C stopped it.
pub fn main(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    let arguments = match Arguments::try_parse_from(arguments) {
        Ok(arguments) => arguments,
        Err(error) => {
            // Where nobody reads the help, there is nobody to tell.
            let _unread = error.print();
            return u8::try_from(error.exit_code()).unwrap_or(2);
        }
    };
    console::start_logging(arguments.verbose);
    let result = match &arguments.command {
        Command::Run(arguments) => run::run(arguments),
        Command::Convert(arguments) => convert::run(arguments),
        Command::Eval(arguments) => eval::run(arguments),
        Command::Info(arguments) => info::run(arguments),
        Command::Mesh(arguments) => mesh::run(arguments),
        Command::Render(arguments) => render::run(arguments),
        Command::Synth(arguments) => synth::run(arguments),
        Command::View(arguments) => view::run(arguments),
        Command::Devices(arguments) => devices::run(arguments),
    };
    result.unwrap_or_else(|error| {
        console::error(&error);
        1
    })
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    #[test]
    fn the_command_line_is_consistent() {
        super::Arguments::command().debug_assert();
    }
}
