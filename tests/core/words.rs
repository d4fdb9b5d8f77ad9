//! One word for one thing: the words that `docs/words.md` replaces are nowhere in sources, pages and messages. And
//! lines that can be read side by side.

use std::path::{Path, PathBuf};

#[test]
fn replaced_words_are_gone() {
    let root = crate::common::root();
    let page = std::fs::read_to_string(root.join("docs/words.md")).expect("the page");
    let rows = page.lines().filter(|line| line.starts_with("| ") && !line.starts_with("| word"));
    let replaced: Vec<String> = rows
        .filter_map(|line| line.split('|').nth(3))
        .flat_map(|cell| cell.split(','))
        .map(|word| word.trim().to_lowercase())
        .filter(|word| !word.is_empty())
        .collect();
    assert!(replaced.len() >= 4, "the table was not read: {replaced:?}");
    let files = texts(&root);
    let mut found = Vec::new();
    for file in files.iter().filter(|file| !file.ends_with("docs/words.md")) {
        let Ok(text) = std::fs::read_to_string(file) else { continue };
        let lines: Vec<String> = text.lines().map(str::to_lowercase).collect();
        for (number, line) in lines.iter().enumerate() {
            // Words that a break parts are in no line alone.
            let next = lines.get(number + 1).map_or("", |next| next.trim_start_matches([' ', '/', '!', '#', '>']));
            let over_break = format!("{} {next}", line.trim_end());
            for word in
                replaced.iter().filter(|word| over_break.contains(word.as_str()) && !next.contains(word.as_str()))
            {
                found.push(format!("{}:{}: {word}", file.display(), number + 1));
            }
        }
    }
    assert!(found.is_empty(), "replaced words:\n{}", found.join("\n"));
}

/// Characters of a line of prose at most: in pages without tables and code, in comments without tables and code.
const WIDEST: usize = 120;

#[test]
fn lines_of_prose_are_not_too_wide() {
    let mut found = Vec::new();
    for file in texts(&crate::common::root()) {
        let Ok(text) = std::fs::read_to_string(&file) else { continue };
        let prose: fn(&str) -> Option<&str> = match file.extension().and_then(|e| e.to_str()) {
            Some("md") => |line| (!line.starts_with("    ")).then_some(line),
            Some("rs") => |line| {
                let comment = line.trim_start().strip_prefix("//")?;
                Some(comment.trim_start_matches(['/', '!']).trim_start())
            },
            _ => continue,
        };
        let mut code = false;
        for (number, line) in text.lines().enumerate() {
            let Some(words) = prose(line) else { continue };
            code ^= words.starts_with("```");
            if !code && !words.starts_with('|') && line.chars().count() > WIDEST {
                found.push(format!("{}:{}", file.display(), number + 1));
            }
        }
    }
    assert!(found.is_empty(), "lines of more than {WIDEST} characters:\n{}", found.join("\n"));
}

/// Pages and sources.
fn texts(root: &Path) -> Vec<PathBuf> {
    let mut files = ["README.md", "CHANGELOG.md", "SECURITY.md"].map(|name| root.join(name)).to_vec();
    for folder in ["src", "crates", "docs", "examples", "tests", "tools", "benches", "fuzz"] {
        gather(&root.join(folder), &mut files);
    }
    assert!(files.len() > 300, "{} files were read", files.len());
    files
}

fn gather(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("readable").path()) {
        let name = entry.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if entry.is_dir() && name != "target" {
            gather(&entry, files);
        } else if entry.extension().is_some_and(|e| ["rs", "md", "js", "html", "toml"].iter().any(|w| e == *w)) {
            files.push(entry);
        }
    }
}
