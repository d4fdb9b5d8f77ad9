//! `autoref-stream gcps convert`: a list of GCPs in another format.

use std::path::PathBuf;

use autoref_raster::atomic::{self, Existing};
use autoref_raster::crs::Crs;
use autoref_stream::gcp::convert::{ConvertOptions, ListFormat, convert};
use clap::{Args, Subcommand};

/// Convert a list of ground control points into another format.
#[derive(Args, Debug)]
pub struct GcpsArgs {
    #[command(subcommand)]
    command: GcpsCommand,
}

#[derive(Subcommand, Debug)]
enum GcpsCommand {
    Convert(ConvertArgs),
}

/// Write a list in another format; what that format cannot hold is left out and named.
#[derive(Args, Debug)]
pub struct ConvertArgs {
    /// The list, in any format that --gcps reads.
    input: PathBuf,
    /// Where to write; the name's end says the format, unless --to does.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Format of the input: geojson, csv, kof, odm, qgis, metashape-csv, metashape-xml, pix4d, micmac, gpkg, shp, fgb,
    /// gml, kml, gpx, gsi, sdr, rw5, sima, landxml, jobxml. Default: recognised by its content and name.
    #[arg(long, value_name = "FORMAT")]
    from: Option<ListFormat>,
    /// Format of the output, of the same ones up to gpx. Default: by its name.
    #[arg(long, value_name = "FORMAT")]
    to: Option<ListFormat>,
    /// CRS of the coordinates (EPSG code, WKT, PROJ string or a file with one), over what the list says.
    #[arg(long, value_name = "CRS")]
    crs: Option<String>,
    /// Bring the coordinates into this CRS. Default: they stay as they are (KML and GPX have longitude and latitude).
    #[arg(long, value_name = "CRS")]
    to_crs: Option<String>,
    /// Layer of a file with several.
    #[arg(long, value_name = "NAME")]
    gcp_layer: Option<String>,
    /// Accept a change of datum that is good to so many metres (default: 1.5).
    #[arg(long, value_name = "M")]
    datum_accuracy: Option<f64>,
    /// Replace an existing output.
    #[arg(long)]
    overwrite: bool,
    /// Print what was done as one JSON document: from, to, points, crs, lost, notes, files_written.
    #[arg(long)]
    json: bool,
}

pub fn run(args: &GcpsArgs) -> anyhow::Result<()> {
    let GcpsCommand::Convert(args) = &args.command;
    atomic::check_outputs(&[&args.output], Existing::of_flag(args.overwrite))?;
    let options = ConvertOptions {
        from: args.from,
        to: args.to,
        crs: args.crs.clone(),
        to_crs: args.to_crs.clone(),
        layer: args.gcp_layer.clone(),
        datum_accuracy_m: args.datum_accuracy,
    };
    let done = convert(&args.input, &args.output, &options)?;
    let files: Vec<String> = done.files.iter().map(|path| path.display().to_string()).collect();
    if args.json {
        let document = serde_json::json!({
            "input": args.input.display().to_string(),
            "from": done.from.name(),
            "to": done.to.name(),
            "points": done.points,
            "crs": done.crs.as_ref().map(Crs::label),
            "lost": done.lost,
            "notes": done.notes,
            "files_written": files,
        });
        println!("{}", serde_json::to_string_pretty(&document)?);
        return Ok(());
    }
    println!("{} points: {} to {}", done.points, done.from.title(), done.to.title());
    for lost in &done.lost {
        println!("Lost: {}", crate::printable(lost));
    }
    if done.lost.is_empty() {
        println!("Nothing was lost");
    }
    for note in &done.notes {
        println!("Note: {}", crate::printable(note));
    }
    println!("Written: {}", files.join(", "));
    Ok(())
}
