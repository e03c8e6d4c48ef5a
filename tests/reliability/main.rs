//! What the service guarantees when things go wrong, row by row: `docs/explanation/reliability.md`.
//!
//! Each row breaks something, judges what comes of it, and judges in the same way a subject that is
//! broken on purpose: a row whose control passes shows nothing, and fails.
//!
//! `cargo reliability` runs every row in its quick form, `cargo reliability --list` names them, and
//! `cargo test --release --test reliability -- --full kill overload` runs some in full, for the
//! figures of the document.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![allow(clippy::print_stdout, clippy::print_stderr)]

mod acknowledgement;
mod command_line;
mod disk_full;
mod faulty_vehicle;
mod flaky;
mod fsck;
mod gateway;
mod interface;
mod io_error;
mod kill;
mod latency;
mod odd_maps;
mod oracle;
mod overload;
mod proc;
mod proxy;
mod random_http;
mod ready;
mod restart;
mod row;
mod shuffled;
mod slow;
mod soak;
mod strace;
mod stub;
mod table;
mod tmpfs;

#[path = "../service/client.rs"]
#[allow(dead_code, reason = "the tests of the service use more of it")]
mod client;
#[path = "../service/drives.rs"]
#[allow(dead_code, reason = "the tests of the service use more of it")]
mod drives;
#[path = "../common/process.rs"]
#[allow(dead_code, reason = "the tests of the service use more of it")]
mod process;
#[path = "../service/changes/reordering.rs"]
mod reordering;
#[path = "../service/changes/reported.rs"]
#[allow(dead_code, reason = "the tests of the service use more of it")]
mod reported;
#[path = "../service/running.rs"]
#[allow(dead_code, reason = "rows start processes; `reported` names it")]
mod running;
#[path = "../service/changes/shop.rs"]
#[allow(dead_code, reason = "the tests of the service use more of it")]
mod shop;
#[path = "../service/spoiled.rs"]
mod spoiled;
#[path = "../service/state.rs"]
#[allow(dead_code, reason = "the tests of the service use more of it")]
mod state;
#[path = "../store/support.rs"]
#[allow(dead_code, reason = "the tests of the store use more of it")]
mod support;

use std::process::ExitCode;

use crate::command_line::CommandLine;
use crate::row::Row;

/// In the order of the document.
const ROWS: [Row; 13] = [
    kill::ROW,
    acknowledgement::ROW,
    disk_full::ROW,
    io_error::ROW,
    faulty_vehicle::ROW,
    slow::ROW,
    overload::ROW,
    flaky::ROW,
    shuffled::ROW,
    restart::ROW,
    random_http::ROW,
    odd_maps::ROW,
    soak::ROW,
];

fn main() -> ExitCode {
    let command_line = CommandLine::of_process();
    let chosen = match command_line.choose(&ROWS) {
        Ok(chosen) => chosen,
        Err(why) => {
            eprintln!("{why}");
            return ExitCode::from(2);
        }
    };
    if command_line.list {
        table::print_list(&chosen);
        return ExitCode::SUCCESS;
    }
    let mut passed = true;
    for row in chosen {
        let verdict = row.verdict(command_line.form());
        table::print_verdict(row, &verdict);
        passed &= verdict.is_no_failure();
    }
    match passed {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    }
}
