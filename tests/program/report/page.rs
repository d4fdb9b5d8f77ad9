//! The page of odd names, long lists, odd images and many marks; and no page where none is asked for.

use super::{Sample, accessible, autoref, count, stderr};
use crate::browser::{Browser, Page};
use autoref_synth::{self as synth, SynthGcp, Visible};

#[test]
fn odd_names_and_long_lists_stay_text() {
    let names = ["\u{202e}drawkcab", "'quoted\"", "", "نقطة ٣", "a\u{0}b", "${D.points}"];
    let sample = Sample::new(
        |_| {},
        |list| {
            for (gcp, name) in list.iter_mut().zip(names) {
                gcp.name = if name.is_empty() { "x".repeat(200) } else { name.replace('\u{0}', " ") };
            }
            // Points far off, which nobody will find.
            for i in 0..480 {
                list.push(SynthGcp {
                    name: format!("far {i}"),
                    easting: list[0].easting + 5000.0 + f64::from(i * i % 977),
                    northing: list[0].northing + 7.0 * f64::from(i),
                    ..list[0].clone()
                });
            }
        },
    );
    let output = sample.run(&["--gsd", "0.03"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(std::fs::metadata(sample.path("e6.report.html")).expect("the report").len() < 3_000_000);
    let Some(mut browser) = Browser::start() else { return };
    browser.open(&sample.path("e6.report.html"));
    assert_eq!(browser.complaints(), Vec::<String>::new());
    assert_eq!(count(&mut browser, "#points-table tbody tr"), 494);
    let wide = browser.eval("document.documentElement.scrollWidth <= window.innerWidth");
    assert_eq!(wide, true, "the page is wider than the window");
    accessible(&mut browser);
}

#[test]
fn an_image_of_one_row_has_a_report_too() {
    let sample = Sample::new(|_| {}, |_| {});
    let source = gdal::Dataset::open(sample.path("e6.tif")).expect("a sample");
    let row = gdal::DriverManager::get_driver_by_name("GTiff")
        .expect("GDAL has it")
        .create_with_band_type::<u8, _>(sample.path("thin.tif"), 2300, 1, 3)
        .expect("created");
    for band in 1..=3 {
        let mut pixels =
            source.rasterband(band).expect("a band").read_as::<u8>((0, 40), (2300, 1), (2300, 1), None).expect("read");
        row.rasterband(band).expect("a band").write((0, 0), (2300, 1), &mut pixels).expect("written");
    }
    drop(row);
    let (image, list) = (sample.path("thin.tif"), sample.path("e6.geojson"));
    let output = autoref(&[image.to_str().expect("plain"), "--gcps", list.to_str().expect("plain"), "--quiet"]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let Some(mut browser) = Browser::start() else { return };
    browser.open(&sample.path("thin.report.html"));
    assert_eq!(browser.complaints(), Vec::<String>::new());
    assert!(browser.eval("document.getElementById('verdict').textContent").to_string().contains("Not georeferenced"));
    // What has no mark to change does not explain how changes are replayed, but how marks are placed.
    let said = |id: &str| format!("document.getElementById('{id}').textContent");
    assert!(!browser.eval(&said("foot")).to_string().contains("--patch"), "there is nothing to replay");
    assert!(browser.eval(&said("marks-note")).to_string().contains("solve MARKS.csv"), "the way by a table");
    // Where nothing can be written: a folder below a file.
    let below = sample.path("thin.tif").join("out");
    let output = autoref(&[
        image.to_str().expect("plain"),
        "--gcps",
        list.to_str().expect("plain"),
        "--out",
        below.to_str().expect("plain"),
    ]);
    assert_eq!((output.status.code(), stderr(&output).trim_end().lines().count()), (Some(2), 1), "{}", stderr(&output));
}

#[test]
fn a_hundred_marks_make_a_page_below_three_megabytes_that_prints() {
    let sample = Sample::new(
        |spec| {
            spec.gcps = synth::random_gcps(100, 64.0, 49.0, 5);
            spec.size_px = Some((2200, 1700));
            spec.visible = Visible::All;
        },
        |_| {},
    );
    let output = sample.run(&[]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let result = sample.json();
    assert!(result["matches"].as_array().map_or(0, Vec::len) >= 95);
    let bytes = std::fs::metadata(sample.path("e6.report.html")).expect("the report").len();
    eprintln!("{bytes} bytes; pictures {} s of {} s", result["timings"]["report_s"], result["elapsed_s"]);
    assert!(bytes < 3_000_000, "{bytes} bytes");
    let Some(mut browser) = Browser::start() else { return };
    browser.open(&sample.path("e6.report.html"));
    assert_eq!(browser.complaints(), Vec::<String>::new());
    let pdf = browser.pdf();
    assert!(pdf.starts_with(b"%PDF") && pdf.len() > 20_000, "{} bytes", pdf.len());
}

#[test]
fn without_a_report_nothing_of_it_is_written() {
    let sample = Sample::new(|_| {}, |_| {});
    std::fs::write(sample.path("e6.report.html"), "mine").expect("writable");
    let refused = sample.run(&[]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(
        stderr(&refused).contains("e6.report.html") && stderr(&refused).contains("--overwrite"),
        "{}",
        stderr(&refused)
    );
    assert_eq!(sample.run(&["--no-report"]).status.code(), Some(0));
    assert_eq!(std::fs::read_to_string(sample.path("e6.report.html")).expect("still there"), "mine");
}
