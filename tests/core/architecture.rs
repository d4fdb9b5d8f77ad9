//! The house: rooms and crates import one way.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

type Imports = BTreeMap<String, BTreeSet<String>>;

/// Crates of the workspace and what each may import of the others: the list of `docs/architecture.md`.
const CRATES: &[(&str, &[&str])] = &[
    ("crates/raster", &[]),
    ("crates/solve", &["autoref-raster"]),
    ("crates/review", &["autoref-raster"]),
    ("crates/synth", &["autoref-raster"]),
    ("crates/elevation", &["autoref-raster"]),
    ("crates/cosine", &[]),
    ("crates/film", &["autoref-cosine", "autoref-raster", "autoref-review", "autoref-solve", "autoref-synth"]),
    ("crates/terrain", &["autoref-raster"]),
    ("crates/cloud", &["autoref-raster"]),
    ("crates/flight", &["autoref-raster", "autoref-synth"]),
    (".", &["autoref-raster", "autoref-review", "autoref-solve", "autoref-synth"]),
    (
        "crates/program",
        &[
            "autoref-cloud",
            "autoref-elevation",
            "autoref-film",
            "autoref-flight",
            "autoref-raster",
            "autoref-review",
            "autoref-solve",
            "autoref-stream",
            "autoref-synth",
            "autoref-terrain",
        ],
    ),
];

#[test]
fn no_room_imports_itself_through_others() {
    let imports = imports(&crate::common::root().join("src"));
    assert!(imports.contains_key("pipeline") && imports["pipeline"].contains("segment"), "the sources were not read");
    if let Some(ring) = ring(&imports) {
        panic!("rooms import each other in a ring: {}", ring.join(" → "));
    }
}

#[test]
fn a_ring_is_seen() {
    let arrow = |from: &str, to: &str| (from.to_owned(), BTreeSet::from([to.to_owned()]));
    assert!(ring(&Imports::from([arrow("a", "b"), arrow("b", "c")])).is_none());
    let found = ring(&Imports::from([arrow("a", "b"), arrow("b", "c"), arrow("c", "b")])).expect("b and c");
    assert_eq!((found.first(), found.last()), (Some(&"b".to_owned()), Some(&"b".to_owned())));
}

#[test]
fn crates_depend_on_what_they_may() {
    let root = crate::common::root();
    for (folder, may) in CRATES {
        let text = std::fs::read_to_string(root.join(folder).join("Cargo.toml")).expect("a manifest");
        let manifest: toml::Table = text.parse().expect("TOML");
        let needed = manifest["dependencies"].as_table().expect("a table");
        for name in needed.keys().filter(|name| name.starts_with("autoref-")) {
            assert!(may.contains(&name.as_str()), "{folder} imports {name}, which docs/architecture.md does not allow");
        }
        for name in *may {
            assert!(needed.contains_key(*name), "docs/architecture.md lets {folder} import {name}, which it does not");
        }
    }
    let page = std::fs::read_to_string(root.join("docs/architecture.md")).expect("the page");
    for member in crates(&root) {
        let name = member.file_name().expect("a folder").to_string_lossy().into_owned();
        assert!(page.contains(&format!("`crates/{name}`")), "docs/architecture.md does not name crates/{name}");
        assert!(CRATES.iter().any(|(folder, _)| *folder == format!("crates/{name}")), "crates/{name} is in no list");
    }
}

fn crates(root: &Path) -> Vec<std::path::PathBuf> {
    let folders = std::fs::read_dir(root.join("crates")).expect("crates");
    folders.map(|entry| entry.expect("readable").path()).filter(|p| p.join("Cargo.toml").exists()).collect()
}

/// Which room of a source tree names which, unit tests and comments apart. A room is a folder or file at the top.
fn imports(top: &Path) -> Imports {
    let mut out = Imports::new();
    let mut todo = vec![top.to_owned()];
    while let Some(path) = todo.pop() {
        if path.is_dir() {
            todo.extend(std::fs::read_dir(&path).expect("readable").map(|entry| entry.expect("readable").path()));
            continue;
        }
        if path.extension().is_none_or(|e| e != "rs") {
            continue;
        }
        let inside = path.strip_prefix(top).expect("below it").to_string_lossy().into_owned();
        let room = inside.split('/').next().expect("a name").trim_end_matches(".rs").to_owned();
        let text = std::fs::read_to_string(&path).expect("UTF-8");
        let code = text.split("#[cfg(test)]\nmod tests").next().expect("a first part");
        let entry = out.entry(room.clone()).or_default();
        for line in code.lines().map(|line| line.split("//").next().expect("a first part")) {
            for named in line.split("crate::").skip(1) {
                assert!(!named.starts_with('{'), "{inside}: one `use` a room, or this test does not see them all");
                let name: String = named.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
                if name != room && !name.is_empty() {
                    entry.insert(name);
                }
            }
        }
    }
    out
}

/// A ring of rooms, its first name again at the end.
fn ring(imports: &Imports) -> Option<Vec<String>> {
    fn visit(
        room: &str,
        imports: &Imports,
        path: &mut Vec<String>,
        done: &mut BTreeSet<String>,
    ) -> Option<Vec<String>> {
        if let Some(at) = path.iter().position(|p| p == room) {
            return Some(path[at..].iter().cloned().chain([room.to_owned()]).collect());
        }
        if !done.insert(room.to_owned()) {
            return None;
        }
        path.push(room.to_owned());
        let found = imports.get(room).into_iter().flatten().find_map(|next| visit(next, imports, path, done));
        path.pop();
        found
    }
    let mut done = BTreeSet::new();
    imports.keys().find_map(|room| visit(room, imports, &mut Vec::new(), &mut done))
}
