//! Where the image of a result is, from the place of the result, and what writes its georeference.

use std::path::{Component, Path, PathBuf};

use autoref_raster::path_text::quoted;
use autoref_stream::result::{ImageInfo, RunResult};

/// Where the image of a result is: a relative name counts from the folder of the result, not from the working
/// directory; an image that was moved together with its result lies beside it. Where it is nowhere, as it was given.
pub fn recorded_image(result: &Path, image: &ImageInfo) -> PathBuf {
    let folder = result.parent().unwrap_or(Path::new(""));
    let given = Path::new(&image.path);
    let places = [
        image.from_result.as_ref().map(|path| folder.join(path)),
        Some(folder.join(given)),
        given.file_name().map(|name| folder.join(name)),
    ];
    places.into_iter().flatten().find(|path| path.exists()).unwrap_or_else(|| given.to_path_buf())
}

/// The image from the folder of its result. `None` where both are in one folder, and where one of the folders cannot be
/// asked.
pub fn from_result(image: &Path, result: &Path) -> Option<String> {
    let (home, folder) = (folder_of(image)?, folder_of(result)?);
    (home != folder)
        .then(|| seen_from(&folder, &home).join(image.file_name().unwrap_or_default()).display().to_string())
}

/// The folder of a file, by its full name without links.
fn folder_of(path: &Path) -> Option<PathBuf> {
    let parent = path.parent()?;
    let parent = if parent.as_os_str().is_empty() { Path::new(".") } else { parent };
    parent.canonicalize().ok()
}

/// One folder from another; by its full name where only the root is common.
fn seen_from(folder: &Path, home: &Path) -> PathBuf {
    let shared = home.components().zip(folder.components()).take_while(|(a, b)| a == b).count();
    if !home.components().take(shared).any(|part| matches!(part, Component::Normal(_))) {
        return home.to_path_buf();
    }
    let up = folder.components().skip(shared).map(|_| Component::ParentDir);
    up.chain(home.components().skip(shared)).collect()
}

/// The command that writes the georeference of a result where its run wrote it.
/// `run_folder`: where its run laid its outputs, when that was not beside the image.
pub fn apply_command(path: &Path, result: &RunResult, run_folder: Option<&Path>) -> String {
    let kinds = result.options.get("write").and_then(serde_json::Value::as_array).into_iter().flatten();
    let kinds: Vec<&str> = kinds.filter_map(serde_json::Value::as_str).collect();
    let write = if kinds.is_empty() { String::new() } else { format!(" --write {}", kinds.join(",")) };
    let of_run = |folder: &Path| if folder.as_os_str().is_empty() { Path::new(".") } else { folder }.to_path_buf();
    let out = run_folder.map_or(String::new(), |folder| format!(" --out {}", quoted(&of_run(folder))));
    format!("autoref-stream apply {}{write}{out} --overwrite", quoted(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_seen_from_another() {
        for (folder, home, seen) in [
            ("/w/a/out", "/w/a", ".."),
            ("/w/out", "/w/a/b", "../a/b"),
            ("/w", "/w/a", "a"),
            ("/tmp/x", "/w/a", "/w/a"),
        ] {
            assert_eq!(seen_from(Path::new(folder), Path::new(home)), Path::new(seen), "{home} from {folder}");
        }
    }
}
