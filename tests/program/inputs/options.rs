//! Every option that names a file to write, with every option that names a file to read: refused before anything is
//! read, so that the files need not hold what they are named for.

use super::super::commands::{CASES, program};
use super::contents;

/// Commands with options that read; `OUT` stands where a file is written. `@` marks what is read.
const LINES: &[&str] = &[
    "@a.tif --gcps @g.csv --crs @c.prj --accuracy @acc.csv --profile @p.toml --closing @el.png --opening @el2.png \
     --dem @dem.tif --write-dem OUT --out o --overwrite",
    "@a.tif --gcps @g.csv --crs @c.prj --accuracy @acc.csv --profile @p.toml --closing @el.png --opening @el2.png \
     --dem @dem.tif --profile-json OUT",
    "detect @a.tif --profile @p.toml --closing @el.png --opening @el2.png -o OUT --overwrite",
    "detect @a.tif --profile @p.toml --closing @el.png --opening @el2.png -o new.csv --profile-json OUT",
    "solve @k.csv --gcps @g.csv --crs @c.prj --accuracy @acc.csv --dem @dem.tif -o OUT --overwrite",
    "solve @k.csv --gcps @g.csv --crs @c.prj --accuracy @acc.csv --dem @dem.tif -o new.json --write-dem OUT",
    "solve @k.csv --gcps @g.csv --crs @c.prj --accuracy @acc.csv --dem @dem.tif -o new.json --profile-json OUT",
    "solve @r.json --patch @t.json -o OUT --overwrite",
    "solve @r.json --patch @t.json -o new.json --profile-json OUT",
    "synth OUT --gcps @g.csv --photos @a.tif --overwrite",
    "synth OUT --gcps @g.csv --as-is @a.tif --overwrite",
    "synth new.tif --gcps @g.csv --photos @a.tif --write-gcps OUT --overwrite",
    "synth new.tif --gcps @g.csv --as-is @a.tif --profile-json OUT",
    "sample @a.tif --gcps @g.csv --crs @c.prj -o OUT --overwrite",
    "sample @a.tif --mask @m.tif -o OUT --overwrite",
    "sample @a.tif --mask @m.tif -o new.toml --html OUT --overwrite",
    "sample @a.tif --mask @m.tif -o new.toml --profile-json OUT",
    "sample @a.tif --polygons @z.geojson -o OUT --overwrite",
    "sample @a.tif --polygons @z.geojson -o new.toml --html OUT --overwrite",
    "sample @a.tif --result @r.json -o OUT --overwrite",
    "sample --colours @k.csv -o OUT --overwrite",
    "sample --colours @k.csv -o new.toml --html OUT --overwrite",
    "chips @a.tif --result @r.json -o new --profile-json OUT",
    "chips @a.tif --gcps @g.csv --crs @c.prj -o new --profile-json OUT",
    "distance @a.tif --profile @p.toml -o OUT --overwrite",
    "distance @a.tif --profile @p.toml -o new.tif --profile-json OUT",
    "apply @r.json @a.tif --out new --profile-json OUT",
    "undo @a.tif --profile-json OUT",
    "mask @a.tif -o new --samples @p.toml --global @z.geojson --mend @t.json --fiducials @r.json --camera @c.toml \
     --profile-json OUT",
    "mask @a.tif -o new --teach a.tif=@m.tif --sample keep=0,0,9,9@@a.tif --profile-json OUT",
    "plan @g.csv --crs @c.prj --image @a.tif --profile-json OUT",
    "selftest @a.tif --profile @p.toml --closing @el.png --opening @el2.png --profile-json OUT",
    "fiducials @a.tif --camera @c.toml --patch @t.json -o new --profile-json OUT",
    "fiducials @a.tif --camera @c.toml --learn --at @t.json -o new --profile-json OUT",
    "synth-film new --camera @c.toml --photos @a.tif --profile-json OUT",
    "synth-flight new --dem @dem.tif --image @a.tif --film @c.toml --profile-json OUT",
    "dem align @d1.tif --to @d2.tif --stable @z.geojson --out OUT --overwrite",
    "dem align @d1.tif --to @d2.tif --stable @z.geojson --out new.tif --profile-json OUT",
    "dem compare @d1.tif @d2.tif --zones @z.geojson --out new --profile-json OUT",
    "dem hillshade @d1.tif --out new.tif --profile-json OUT",
    "dem slope @d1.tif --out new.tif --profile-json OUT",
    "dem aspect @d1.tif --out new.tif --profile-json OUT",
    "dem roughness @d1.tif --out new.tif --profile-json OUT",
    "dem tri @d1.tif --out new.tif --profile-json OUT",
    "dem tpi @d1.tif --out new.tif --profile-json OUT",
    "dem contour @d1.tif --out new.gpkg --interval 5 --profile-json OUT",
    "dem profile @d1.tif @d2.tif --line 0,0;9,9 --out OUT --overwrite",
    "dem profile @d1.tif @d2.tif --line 0,0;9,9 --profile-json OUT",
    "dem resample @d1.tif --out new.tif --resolution 9 --profile-json OUT",
    "dem colour @d1.tif --table @k.csv --out OUT --overwrite",
    "dem colour @d1.tif --table @k.csv --out new.tif --profile-json OUT",
    "mosaic @d1.tif @d2.tif --use-index @m.tif --out OUT --overwrite",
    "mosaic @d1.tif @d2.tif --out new.tif --write-index OUT --overwrite",
    "mosaic @d1.tif @d2.tif --balance --balance-to @d2.tif --balance-page OUT --out new.tif --overwrite",
    "mosaic @d1.tif @d2.tif --use-index @m.tif --out new.tif --profile-json OUT",
    "flight init frames --cameras @k.csv --gcps @g.csv --observations @o.csv --crs @c.prj -o OUT --overwrite",
    "flight init frames --cameras @k.csv --gcps @g.csv --crs @c.prj -o new.toml --profile-json OUT",
    "flight solve @p.toml -o new --profile-json OUT",
    "flight adjust @r.json --gcps @g.csv --observations @o.csv --crs @c.prj --cameras @k.csv -o OUT --overwrite",
    "flight adjust @r.json --gcps @g.csv --observations @o.csv --crs @c.prj -o new.json --profile-json OUT",
    "flight resect @a.tif --gcps @g.csv --observations @o.csv --crs @c.prj --camera @c.toml -o OUT --overwrite",
    "flight resect @a.tif --gcps @g.csv --camera @c.toml -o new.json --profile-json OUT",
    "flight orthorectify @a.tif --dem @dem.tif --cameras @k.csv --camera @c.toml --crs @c.prj -o OUT --overwrite",
    "flight orthorectify @a.tif --dem @dem.tif --cameras @k.csv -o new.tif --profile-json OUT",
    "flight export @p.toml -o new --profile-json OUT",
    "flight click @p.toml -o new --profile-json OUT",
    "cloud clean @k.xyz --range-from @k.csv --crop @z.geojson --crs @c.prj --out OUT --overwrite",
    "cloud clean @k.xyz --range-from @k.csv --crop @z.geojson --out new.las --profile-json OUT",
    "cloud grid @k.xyz --cell 4 --range-from @k.csv --crs @c.prj --out new --profile-json OUT",
    "cloud info @k.xyz --profile-json OUT",
    "gcps convert @g.csv --crs @c.prj -o OUT --to csv --overwrite",
    "gcps convert @g.csv --crs @c.prj -o new.csv --profile-json OUT",
    "compare-solvers @a.tif --gcps @g.csv --accuracy @acc.csv --profile @p.toml --dem @dem.tif --profile-json OUT",
    "patterns @k.csv --gcps @g.csv --crs @c.prj -o OUT --overwrite",
    "patterns @k.csv --gcps @g.csv --crs @c.prj --profile-json OUT",
];

/// Commands that read no file, or (with `--write tags` and `undo`) change their input because that is asked for.
const READ_NONE: &[&str] = &["completions", "man", "help"];

/// The words of a line without the marks, and the names that are marked.
fn parts(line: &str) -> (Vec<String>, Vec<String>) {
    let mut read = Vec::new();
    let words = line.split_whitespace().map(|word| {
        let word = word.replace(';', " ");
        match word.rsplit_once('@') {
            Some((before, name)) => {
                read.push(name.to_owned());
                format!("{before}{name}")
            }
            None => word,
        }
    });
    (words.collect(), read)
}

/// A command's name, the option that names an input (or nothing), and the input.
fn place_of(words: &[String], input: &str) -> [String; 3] {
    let at = words.iter().position(|word| word.ends_with(input)).expect("one of the words");
    let has_parts = ["dem", "flight", "cloud", "gcps"].contains(&words[0].as_str());
    let command = words.iter().take(if has_parts { 2 } else { 1 }).cloned().collect::<Vec<_>>().join(" ");
    let option = at.checked_sub(1).map(|before| &words[before]).filter(|word| word.starts_with('-'));
    [command, option.cloned().unwrap_or_default(), input.to_owned()]
}

/// The three names of an input: its own, a hard and a soft link. In `make test` one of them in turn, and inputs that
/// another line of the command tries only where a line has no others: one of them in turn.
#[test]
fn no_option_that_writes_takes_what_an_option_reads() {
    let folder = tempfile::tempdir().expect("a folder");
    let dir = folder.path();
    std::fs::create_dir(dir.join("frames")).expect("a folder");
    for name in LINES.iter().flat_map(|line| parts(line).1) {
        std::fs::write(dir.join(&name), format!("{name} is an input")).expect("writable");
    }
    let before = contents(dir);
    let (all, mut pairs, mut tried) = (crate::common::large(), 0, std::collections::BTreeSet::new());
    for (number, line) in LINES.iter().enumerate() {
        let (words, mut read) = parts(line);
        let again = read[number % read.len()].clone();
        read.retain(|input| tried.insert(place_of(&words, input)) || all);
        if read.is_empty() {
            read.push(again);
        }
        for (place, input) in read.iter().enumerate() {
            for way in (0..3).filter(|way| all || *way == (number + place) % 3) {
                let end = input.rsplit_once('.').map_or("", |(_, end)| end);
                let linked = format!("link.{end}");
                let output = if way == 0 { input.clone() } else { linked.clone() };
                match way {
                    0 => (),
                    1 => std::fs::hard_link(dir.join(input), dir.join(&linked)).expect("links"),
                    _ => std::os::unix::fs::symlink(dir.join(input), dir.join(&linked)).expect("links"),
                }
                let words: Vec<&str> =
                    words.iter().map(|word| if word == "OUT" { &output } else { word.as_str() }).collect();
                let out = program(dir, &words);
                let said = String::from_utf8_lossy(&out.stderr);
                let _ = std::fs::remove_file(dir.join(&linked));
                assert_eq!(out.status.code(), Some(2), "{words:?}: {said}");
                let is_named = said.contains(&output) && said.contains("input");
                assert!(is_named && said.trim_end().lines().count() == 1, "{words:?}: {said}");
                assert!(contents(dir) == before, "{words:?} changed a file");
                pairs += 1;
            }
        }
    }
    println!("{} lines, {pairs} pairs", LINES.len());
    assert!(pairs >= if all { 550 } else { 120 }, "{pairs} pairs were tried");
}

/// A new command is tried here, or among the cases that run to their end.
#[test]
fn every_command_is_tried() {
    let dir = tempfile::tempdir().expect("a folder");
    let commands = |words: &[&str]| -> Vec<String> {
        let help = program(dir.path(), &[words, &["--help"]].concat());
        let help = String::from_utf8(help.stdout).expect("text");
        let listed = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
        let names = listed.filter(|line| line.starts_with("  ") && !line.starts_with("   "));
        names.filter_map(|line| line.split_whitespace().next().map(str::to_owned)).collect()
    };
    let mut leaves = Vec::new();
    for command in commands(&[]) {
        let inner = commands(&[&command]);
        match inner.is_empty() {
            true => leaves.push(command),
            false => leaves.extend(inner.iter().filter(|name| *name != "help").map(|name| format!("{command} {name}"))),
        }
    }
    assert!(leaves.len() > 40, "{leaves:?}");
    let lines = || LINES.iter().copied().chain(CASES.iter().map(|case| case.line));
    let is_tried = |leaf: &String| lines().any(|line| line.starts_with(&format!("{leaf} ")));
    let left: Vec<&String> =
        leaves.iter().filter(|leaf| !READ_NONE.contains(&leaf.as_str()) && !is_tried(leaf)).collect();
    assert!(left.is_empty(), "no line tries {left:?}");
}
