//! Which numbers of the 3D front end matter: the errors of local SLAM alone, with one setting after the other changed.
//!
//! `cargo run --profile quick -p portolan --example settings_3d -- RECORDING:TRUTH[:X,Y,Z] … [GROUP.FIELD=VALUE[;…] …]`
//!
//! Truths are trajectories as `portolan evaluate` reads them, X, Y, Z the place in the tracking frame, metres, that they
//! are of. Without settings every one is halved and doubled. A row shows for each recording the ATE in metres, and in
//! brackets how far the place after ten sweeps is off in metres (root mean square), begun at every eighth sweep.

mod drive;

use std::error::Error;
use std::io::Write;

use drive::Drive;
use portolan::lidar_odometry::OdometrySettings;

/// What is changed at once: group, field, values.
type Changes = Vec<(String, String, Vec<f64>)>;

fn main() -> Result<(), Box<dyn Error>> {
    let (mut drives, mut rows): (Vec<Drive>, Vec<(String, Changes)>) = (Vec::new(), Vec::new());
    for argument in std::env::args().skip(1) {
        if argument.contains('=') {
            rows.push((argument.clone(), changes(&argument)?));
        } else {
            drives.push(Drive::read(&argument)?);
        }
    }
    if rows.is_empty() {
        rows = halved_and_doubled();
    }
    rows.insert(0, ("as it is".into(), Vec::new()));
    let mut out = std::io::stdout();
    let names: Vec<&str> = drives.iter().map(|drive| drive.name.as_str()).collect();
    writeln!(out, "| setting | {} |\n|---|{}", names.join(" | "), "---|".repeat(drives.len()))?;
    for (name, changes) in rows {
        let mut cells = Vec::new();
        for drive in &drives {
            let mut settings = drive.settings.clone();
            for (group, field, values) in &changes {
                settings.set(group, field, values)?;
            }
            cells.push(format!("{:.4} ({:.3})", drive.error(&settings)?, drive.error_of_starts(&settings)));
        }
        writeln!(out, "| {name} | {} |", cells.join(" | "))?;
    }
    Ok(())
}

fn halved_and_doubled() -> Vec<(String, Changes)> {
    let entries = OdometrySettings::default().entries();
    let row = |factor: f64| {
        move |entry: &portolan::lidar_odometry::settings::Entry| {
            let values = entry.values.iter().map(|value| factor * value).collect();
            let name = format!("{}.{} × {factor}", entry.group, entry.name);
            (name, vec![(entry.group.to_string(), entry.name.to_string(), values)])
        }
    };
    entries.iter().flat_map(|entry| [row(0.5)(entry), row(2.0)(entry)]).collect()
}

fn changes(argument: &str) -> Result<Changes, Box<dyn Error>> {
    let change = |text: &str| -> Result<_, Box<dyn Error>> {
        let (name, values) = text.split_once('=').ok_or("expected GROUP.FIELD=VALUE")?;
        let (group, field) = name.split_once('.').ok_or("expected GROUP.FIELD=VALUE")?;
        let values = values.split(',').map(str::parse::<f64>).collect::<Result<Vec<_>, _>>()?;
        Ok((group.to_string(), field.to_string(), values))
    };
    argument.split(';').map(change).collect()
}
