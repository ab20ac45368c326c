//! The `itm` program.

fn main() -> std::process::ExitCode {
    itm_cli::main(std::env::args_os()).into()
}
