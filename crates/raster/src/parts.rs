//! Parts of outputs that are being made, so that a run that is told to end leaves none behind.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// What is being made now.
static PARTS: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());
/// How many outputs are being put in place now.
static PLACING: AtomicUsize = AtomicUsize::new(0);
static ENDING: AtomicBool = AtomicBool::new(false);

/// A hidden name beside `path`, of this process; the extension is kept.
pub(crate) fn temporary_name(path: &Path) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let extension = path.extension().map_or(String::new(), |e| format!(".{}", e.to_string_lossy()));
    path.with_file_name(format!(".{stem}.{}.part{extension}", std::process::id()))
}

/// What a process that has ended without a word left beside an output.
pub(crate) struct Leftover {
    pub(crate) path: PathBuf,
    /// Of the file that it was to be, or was.
    pub(crate) stem: String,
    /// The file of which it is a second name, where it is no part.
    pub(crate) was: Option<PathBuf>,
}

/// The end of second names.
pub(crate) const BEFORE: &str = ".before";

/// What processes that are gone left in the folder of `output`.
pub(crate) fn leftovers(output: &Path) -> impl Iterator<Item = Leftover> {
    let folder = output.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::read_dir(folder).into_iter().flatten().flatten().filter_map(|entry| {
        let name = entry.file_name().to_string_lossy().into_owned();
        // The number stands before it: names of files may have the word in them.
        let name = name.strip_prefix('.')?;
        let (stem, process, end) = name.match_indices(".part").find_map(|(at, word)| {
            let (stem, process) = name[..at].rsplit_once('.')?;
            Some((stem, process.parse::<u32>().ok()?, &name[at + word.len()..]))
        })?;
        if !(end.is_empty() || end.starts_with('.')) {
            return None;
        }
        let was = end.strip_suffix(BEFORE).map(|end| output.with_file_name(format!("{stem}{end}")));
        // Without /proc nobody can say whether the process lives.
        let has_ended = Path::new("/proc/self").exists() && !Path::new(&format!("/proc/{process}")).exists();
        has_ended.then(|| Leftover { path: entry.path(), stem: stem.to_string(), was })
    })
}

const PAUSE: Duration = Duration::from_millis(5);

/// A file or folder under a temporary name, from before it is made until it is in place or gone: a run that is told to
/// end removes it.
pub struct Part(PathBuf);

impl Part {
    /// Of a hidden name that nothing else begins with.
    pub fn of(temporary: &Path) -> Part {
        PARTS.lock().unwrap_or_else(PoisonError::into_inner).push(temporary.to_owned());
        Part(temporary.to_owned())
    }
}

impl Drop for Part {
    fn drop(&mut self) {
        let mut parts = PARTS.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(at) = parts.iter().position(|part| *part == self.0) {
            parts.swap_remove(at);
        }
    }
}

/// Outputs are put in place together or not at all: the end of the run waits while this lives.
pub(crate) struct Placing;

impl Placing {
    pub(crate) fn begin() -> Placing {
        loop {
            // Counted before the end is asked for, so that the end sees it. What begins within another one must not
            // wait for the end, which waits for that one.
            let others = PLACING.fetch_add(1, Ordering::SeqCst);
            if others > 0 || !ENDING.load(Ordering::SeqCst) {
                return Placing;
            }
            PLACING.fetch_sub(1, Ordering::SeqCst);
            std::thread::sleep(PAUSE);
        }
    }
}

impl Drop for Placing {
    fn drop(&mut self) {
        PLACING.fetch_sub(1, Ordering::SeqCst);
    }
}

/// Removes all parts of outputs, for a run that ends now; outputs that are being put in place come whole first. No
/// output is put in place afterwards: the process must end.
pub fn abandon() {
    /// A disk that gives no answer must not hold the end up.
    const LONGEST_WAIT: Duration = Duration::from_secs(10);
    ENDING.store(true, Ordering::SeqCst);
    let began = Instant::now();
    while PLACING.load(Ordering::SeqCst) > 0 && began.elapsed() < LONGEST_WAIT {
        std::thread::sleep(PAUSE);
    }
    for part in PARTS.lock().unwrap_or_else(PoisonError::into_inner).iter() {
        remove(part);
    }
}

/// Removes a part, and what GDAL keeps beside it while it works.
fn remove(part: &Path) {
    let (Some(folder), Some(stem)) = (part.parent(), part.file_stem()) else { return };
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let stem = stem.to_string_lossy();
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        // A second name of what is being replaced is kept.
        let is_part = name.strip_prefix(stem.as_ref()).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'));
        if is_part && !name.ends_with(BEFORE) {
            let path = entry.path();
            // What cannot be removed stays, as after a kill.
            let _ = if path.is_dir() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_goes_with_its_companions_and_nothing_else() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let part = folder.path().join(".a.17.part.tif");
        let kept = ["a.tif", ".a.17.part.tif.before", ".a.17.parts", ".b.17.part.tif"];
        let gone = [".a.17.part.tif", ".a.17.part.tif.warp.tmp", ".a.17.part.tif.ovr.tmp"];
        for name in kept.iter().chain(&gone) {
            std::fs::write(folder.path().join(name), b"x").expect("writable");
        }
        let _known = Part::of(&part);
        remove(&part);
        assert!(kept.iter().all(|name| folder.path().join(name).exists()));
        assert!(gone.iter().all(|name| !folder.path().join(name).exists()));
    }
}
