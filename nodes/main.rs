//! The command `osteoflow`.

use std::process::ExitCode;

fn main() -> ExitCode {
    osteoflow::main(std::env::args_os()).into()
}
