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
    let of = |tree: &str| imports(&crate::common::root().join(tree));
    for (tree, from, to) in [("src", "pipeline", "segment"), ("crates/film/src", "learn", "shown")] {
        assert!(of(tree).get(from).is_some_and(|names| names.contains(to)), "{tree}: the sources were not read");
    }
    for tree in CRATES.iter().map(|(folder, _)| format!("{folder}/src")) {
        if let Some(ring) = ring(&of(&tree)) {
            panic!("{tree}: rooms import each other in a ring: {}", ring.join(" → "));
        }
    }
}

#[test]
fn imports_are_seen_however_they_are_written() {
    let code = "use crate::{a, b::{C, D},\n e as f};\nuse super::{g::H,\n    i};\nlet k = super::j::j() + crate::l();\n\
                use super::super::m::{N, o};\nuse self::p::Q;";
    assert_eq!(named(code, 1).into_iter().collect::<String>(), "abegijl");
    assert_eq!(named(code, 2).into_iter().collect::<String>(), "abelm");
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

/// Which room of a source tree names which, unit tests and comments apart. A room is a folder or file at the top, but
/// not the crate's own `lib.rs` or `main.rs`.
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
        if ["lib.rs", "main.rs"].contains(&inside.as_str()) {
            continue;
        }
        let room = inside.split('/').next().expect("a name").trim_end_matches(".rs").to_owned();
        let text = std::fs::read_to_string(&path).expect("UTF-8");
        let code = text.split("#[cfg(test)]\nmod tests").next().expect("a first part");
        let code: Vec<&str> = code.lines().map(|line| line.split("//").next().expect("a first part")).collect();
        let depth = inside.split('/').count() - usize::from(inside.ends_with("/mod.rs"));
        let mut names = named(&code.join("\n"), depth);
        names.remove(&room);
        out.entry(room).or_default().extend(names);
    }
    out
}

/// What code names of its crate's top: after `crate::`, and after as many `super::` as lead there from a module `depth`
/// levels below it.
fn named(code: &str, depth: usize) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    for top in ["crate::".to_owned(), "super::".repeat(depth)] {
        for (at, _) in code.match_indices(&top) {
            let (before, path) = (&code[..at], &code[at + top.len()..]);
            if !before.ends_with("::") && !path.starts_with("super::") {
                names.extend(members(path).into_iter().map(first_name).filter(|name| !name.is_empty()));
            }
        }
    }
    names
}

/// The members of a group in braces, or the one path there is.
fn members(path: &str) -> Vec<&str> {
    let Some(group) = path.strip_prefix('{') else { return vec![path] };
    let (mut members, mut begin, mut level) = (vec![], 0, 0);
    for (at, c) in group.char_indices() {
        match c {
            ',' | '}' if level == 0 => {
                members.push(&group[begin..at]);
                begin = at + 1;
                if c == '}' {
                    break;
                }
            }
            '{' => level += 1,
            '}' => level -= 1,
            _ => {}
        }
    }
    members
}

fn first_name(path: &str) -> String {
    path.trim_start().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()
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
