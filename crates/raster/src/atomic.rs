//! Files that appear whole or not at all.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

pub use crate::aside::refuse_left_behind;
pub use crate::parts::{Part, abandon};

use crate::aside::{Aside, remove_second_names};
use crate::error::{Error, Result};
use crate::fingerprint::Fingerprint;
use crate::parts::{BEFORE, Placing, leftovers, temporary_name};
use crate::protected::{refuse_input, refuse_inputs_beside};
use crate::sidecars::parts_of;
use crate::written::Written;

/// What this process has put in place, in that order.
static COMPLETED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

fn complete(path: &Path) {
    let mut all = COMPLETED.lock().unwrap_or_else(PoisonError::into_inner);
    if !all.iter().any(|other| other == path) {
        all.push(path.to_owned());
    }
}

/// Every file that this process has put in place, each once, in the order in which they first appeared.
pub fn completed() -> Vec<PathBuf> {
    COMPLETED.lock().unwrap_or_else(PoisonError::into_inner).clone()
}

/// Writes `content` under a temporary name beside `path`, brings it to disk, and renames it. A device, FIFO or socket
/// is written into: a rename would replace it.
///
/// # Errors
/// When the system says no, or `path` is an input; nothing is left behind then.
pub fn write(path: &Path, content: &[u8]) -> Result<()> {
    if is_special(path) {
        return open_special(path)
            .and_then(|mut file| file.write_all(content))
            .map_err(|e| Error::io(path, "write", e));
    }
    with_temporary(path, |temporary| {
        let mut file = std::fs::File::create(temporary).map_err(|e| Error::io(path, "create", e))?;
        file.write_all(content).and_then(|()| file.sync_all()).map_err(|e| Error::io(path, "write", e))
    })
}

/// Opens what is no file for writing. Of a FIFO that nobody reads yet it says that it waits.
fn open_special(path: &Path) -> std::io::Result<std::fs::File> {
    use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
    use std::os::unix::fs::OpenOptionsExt;
    let flag = i32::try_from(OFlags::NONBLOCK.bits()).expect("flags of the system are of its C int");
    match std::fs::OpenOptions::new().write(true).custom_flags(flag).open(path) {
        Ok(file) => {
            fcntl_setfl(&file, fcntl_getfl(&file)? - OFlags::NONBLOCK)?;
            Ok(file)
        }
        // A socket says the same, and no waiting helps.
        Err(error) if error.raw_os_error() == Some(rustix::io::Errno::NXIO.raw_os_error()) && is_fifo(path) => {
            tracing::warn!("{}: waiting for a program that reads from it", path.display());
            std::fs::OpenOptions::new().write(true).open(path)
        }
        Err(error) => Err(error),
    }
}

fn is_fifo(path: &Path) -> bool {
    use std::os::unix::fs::FileTypeExt;
    std::fs::metadata(path).is_ok_and(|found| found.file_type().is_fifo())
}

/// Lets `produce` make a file under a temporary name in the same folder, then renames it to `path`. The extension is
/// kept, since GDAL's drivers look at it. Companions of a file that is replaced go with it.
///
/// # Errors
/// Those of `produce` and of the renaming; the temporary file is removed then.
pub fn with_temporary(path: &Path, produce: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
    refuse_input(path)?;
    refuse_inputs_beside(path)?;
    refuse_special(path)?;
    remove_leftovers(path);
    let temporary = temporary_name(path);
    let _part = Part::of(&temporary);
    let parts = parts_of(path);
    parts.iter().try_for_each(|end| refuse_input(&path.with_extension(end)))?;
    let result = watched(&temporary, || produce(&temporary)).and_then(|()| {
        let mut together = Transaction::new();
        for end in parts.iter().filter(|end| temporary.with_extension(end).exists()) {
            together.adopt(&temporary.with_extension(end), &path.with_extension(end));
        }
        // What the parts belong to comes last.
        together.adopt(&temporary, path);
        together.commit()
    });
    if result.is_err() {
        // They may not exist; the first error is the one to report.
        let _ = std::fs::remove_file(&temporary);
        parts.iter().for_each(|end| {
            let _ = std::fs::remove_file(temporary.with_extension(end));
        });
    }
    result.map_err(|error| renamed(error, &[temporary], &[path.to_owned()]))
}

/// Lets `produce` fill a folder under a temporary name, which then replaces the folder `path`, if there is one, whole.
///
/// # Errors
/// Those of `produce` and of the system; [`Error::Usage`] when `path` is a file. Nothing is changed then.
pub fn folder<R>(path: &Path, produce: impl FnOnce(&Path) -> Result<R>) -> Result<R> {
    if path.exists() && !path.is_dir() {
        let what = format!("the output {} is a file, and a folder must be made", path.display());
        return Err(Error::usage(what, "name another output"));
    }
    remove_leftovers(path);
    let temporary = temporary_name(path);
    let _part = Part::of(&temporary);
    let made = std::fs::create_dir_all(&temporary).map_err(|e| Error::io(path, "create", e)).and_then(|()| {
        let made = watched(&temporary, || produce(&temporary))?;
        let _placing = Placing::begin();
        if path.is_dir() {
            std::fs::remove_dir_all(path).map_err(|e| Error::io(path, "put in place of the old folder", e))?;
        }
        std::fs::rename(&temporary, path).map_err(|e| Error::io(path, "put in place", e))?;
        Ok(made)
    });
    if made.is_err() {
        // The first error is the one to report.
        let _ = std::fs::remove_dir_all(&temporary);
    }
    made.map_err(|error| renamed(error, &[temporary], &[path.to_owned()]))
}

/// What GDAL fails at while `produce` makes a file is a failure of `produce`: closing a dataset does not tell of it.
fn watched<R>(path: &Path, produce: impl FnOnce() -> Result<R>) -> Result<R> {
    let watch = Written::watch(path);
    let made = produce()?;
    watch.nothing_failed()?;
    Ok(made)
}

/// Whether there is something at `path` that is neither file nor folder.
fn is_special(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir())
}

fn refuse_special(path: &Path) -> Result<()> {
    if is_special(path) {
        let what = format!(
            "the output {} is a device, FIFO or socket, which this format cannot be written into",
            path.display()
        );
        return Err(Error::usage(what, "name a file"));
    }
    Ok(())
}

/// Removes part files of the same output whose process has ended without a word. Second names of what it was replacing
/// stay until there is a new output.
fn remove_leftovers(path: &Path) {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    for leftover in leftovers(path).filter(|leftover| leftover.was.is_none() && leftover.stem == stem) {
        // It may be somebody else's; then it stays.
        let path = leftover.path;
        let _ = if path.is_dir() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
    }
}

/// An edit that is not a file of its own: done after all files are in place, and taken back when a later one fails.
pub trait Edit {
    /// Does it, whole or not at all.
    ///
    /// # Errors
    /// When the system says no; the file is then as it was.
    fn apply(&mut self) -> Result<()>;
    /// Takes it back.
    ///
    /// # Errors
    /// When the system says no.
    fn revert(&mut self) -> Result<()>;
    /// For the list of what was written.
    fn path(&self) -> &Path;
}

/// Several files that appear together or not at all.
///
/// Each is made under a temporary name; [`Transaction::commit`] renames them, and companions of files that are replaced
/// go with these. When a renaming or the edit at the end fails, files that were replaced come back and new ones are
/// removed. Dropped without commit, it leaves nothing.
#[derive(Default)]
pub struct Transaction {
    staged: Vec<Staged>,
    edits: Vec<Box<dyn Edit>>,
}

struct Staged {
    temporary: PathBuf,
    target: PathBuf,
    /// A second name of what `target` was, while the commit runs.
    backup: Option<PathBuf>,
    in_place: bool,
    _part: Part,
}

impl Transaction {
    /// One that holds nothing yet.
    pub fn new() -> Self {
        Transaction::default()
    }

    /// Lets `produce` make the file under a temporary name in the same folder; the extension is kept.
    ///
    /// # Errors
    /// Those of `produce`, and of bringing the file to disk.
    pub fn stage(&mut self, target: &Path, produce: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
        self.stage_all(&[target.to_path_buf()], |temporaries| produce(&temporaries[0]))
    }

    /// The same for several files that one call makes.
    ///
    /// # Errors
    /// Those of `produce`, and of bringing the files to disk.
    pub fn stage_all(&mut self, targets: &[PathBuf], produce: impl FnOnce(&[PathBuf]) -> Result<()>) -> Result<()> {
        for (number, target) in targets.iter().enumerate() {
            refuse_input(target)?;
            refuse_inputs_beside(target)?;
            refuse_special(target)?;
            remove_leftovers(target);
            let staged = self.staged.iter().map(|staged| &staged.target).chain(&targets[..number]);
            if staged.into_iter().any(|other| other == target) {
                let what = format!("two outputs of this command are {}", target.display());
                return Err(Error::usage(what, "name them apart"));
            }
        }
        let temporaries: Vec<PathBuf> = targets.iter().map(|target| temporary_name(target)).collect();
        targets.iter().zip(&temporaries).for_each(|(target, temporary)| self.adopt(temporary, target));
        watched(&temporaries[0], || produce(&temporaries)).map_err(|error| renamed(error, &temporaries, targets))?;
        for (target, temporary) in targets.iter().zip(&temporaries) {
            std::fs::File::open(temporary)
                .and_then(|file| file.sync_all())
                .map_err(|e| Error::io(target, "bring to disk", e))?;
        }
        Ok(())
    }

    /// Takes a file that is made, or will be, under its temporary name.
    fn adopt(&mut self, temporary: &Path, target: &Path) {
        let (temporary, target) = (temporary.to_owned(), target.to_owned());
        let _part = Part::of(&temporary);
        self.staged.push(Staged { temporary, target, backup: None, in_place: false, _part });
    }

    /// The same for bytes.
    ///
    /// # Errors
    /// When they cannot be written.
    pub fn stage_bytes(&mut self, target: &Path, content: &[u8]) -> Result<()> {
        self.stage(target, |temporary| std::fs::write(temporary, content).map_err(|e| Error::io(target, "write", e)))
    }

    /// Adds an edit that is done last.
    pub fn on_commit(&mut self, edit: impl Edit + 'static) {
        self.edits.push(Box::new(edit));
    }

    /// What will be written, edited files last.
    pub fn paths(&self) -> Vec<PathBuf> {
        let files = self.staged.iter().map(|staged| staged.target.clone());
        files.chain(self.edits.iter().map(|edit| edit.path().to_path_buf())).collect()
    }

    /// What is staged, each file by its target with the fingerprint of its content.
    ///
    /// # Errors
    /// When a staged file cannot be read.
    pub fn fingerprints(&self) -> Result<Vec<(PathBuf, String)>> {
        let of_file = |staged: &Staged| {
            let mut fingerprint = Fingerprint::default();
            fingerprint.file(&staged.temporary)?;
            Ok((staged.target.clone(), fingerprint.hex()))
        };
        self.staged.iter().map(of_file).collect()
    }

    /// Puts everything in place.
    ///
    /// # Errors
    /// When the system says no; what was there before is there again then.
    pub fn commit(mut self) -> Result<()> {
        let _placing = Placing::begin();
        // A single file comes whole by itself; on a disk without second names keeping the old one would copy it.
        if self.staged.len() + self.edits.len() > 1 {
            self.staged.iter_mut().try_for_each(Staged::keep_old)?;
        }
        let is_written = |path: &Path| self.staged.iter().any(|staged| staged.target == path);
        let old = self.staged.iter().map(|staged| Aside::take(&staged.target, is_written));
        let old: Vec<Aside> = old.collect::<Result<_>>()?;
        for staged in &mut self.staged {
            std::fs::rename(&staged.temporary, &staged.target)
                .map_err(|e| Error::io(&staged.target, "put in place", e))?;
            staged.in_place = true;
        }
        for number in 0..self.edits.len() {
            if let Err(error) = self.edits[number].apply() {
                for done in self.edits[..number].iter_mut().rev() {
                    // The first error is the one to report.
                    let _ = done.revert();
                }
                return Err(error);
            }
        }
        old.into_iter().for_each(Aside::remove);
        for staged in self.staged.drain(..) {
            complete(&staged.target);
            if let Some(backup) = &staged.backup {
                // A leftover second name harms nobody; the output itself is good.
                let _ = std::fs::remove_file(backup);
            }
            remove_second_names(&staged.target);
        }
        Ok(())
    }
}

impl Staged {
    /// Gives the file that will be replaced a second name.
    fn keep_old(&mut self) -> Result<()> {
        if !self.target.exists() {
            return Ok(());
        }
        let mut backup = temporary_name(&self.target).into_os_string();
        backup.push(BEFORE);
        let backup = PathBuf::from(backup);
        // A leftover of a crashed run with the same process number.
        let _ = std::fs::remove_file(&backup);
        std::fs::hard_link(&self.target, &backup)
            .or_else(|_| std::fs::copy(&self.target, &backup).map(|_| ()))
            .map_err(|e| Error::io(&self.target, "keep while it is replaced", e))?;
        self.backup = Some(backup);
        Ok(())
    }
}

impl Drop for Transaction {
    fn drop(&mut self) {
        for staged in &self.staged {
            // Whatever fails here, the first error is the one that was reported.
            let _ = match (&staged.backup, staged.in_place) {
                (Some(backup), true) => std::fs::rename(backup, &staged.target),
                (None, true) => std::fs::remove_file(&staged.target),
                (Some(backup), false) => std::fs::remove_file(backup),
                (None, false) => Ok(()),
            };
            if !staged.in_place {
                let _ = std::fs::remove_file(&staged.temporary);
            }
        }
    }
}

/// Whether a file is a step towards a temporary one: it has its name with another ending.
fn beside(path: &Path, temporary: &Path) -> bool {
    let stem = temporary.file_stem().unwrap_or_default().to_string_lossy().into_owned() + ".";
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    path.parent() == temporary.parent() && stem.len() > 1 && name.starts_with(&stem)
}

/// Messages speak of the file that was asked for, not of its temporary name.
fn renamed(error: Error, temporaries: &[PathBuf], targets: &[PathBuf]) -> Error {
    let real = |path: PathBuf| {
        let below = temporaries.iter().zip(targets).find_map(|(t, target)| Some((path.strip_prefix(t).ok()?, target)));
        match below {
            Some((rest, target)) if rest.as_os_str().is_empty() => target.clone(),
            Some((rest, target)) => target.join(rest),
            None => temporaries.iter().zip(targets).find(|(t, _)| beside(&path, t)).map_or(path, |(_, t)| t.clone()),
        }
    };
    let words = |mut text: String| {
        for (temporary, target) in temporaries.iter().zip(targets) {
            text = text.replace(&temporary.display().to_string(), &target.display().to_string());
        }
        text
    };
    match error {
        Error::Io { path, action, source } => Error::Io { path: real(path), action, source },
        Error::Gdal { path, what } => Error::Gdal { path: real(path), what: words(what) },
        Error::Format { path, place, what } => Error::Format { path: real(path), place, what: words(what) },
        other => other,
    }
}

/// What becomes of an output that exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// The command is refused.
    Keep,
    Replace,
}

impl Existing {
    /// As `--overwrite` says.
    pub fn of_flag(overwrite: bool) -> Self {
        if overwrite { Existing::Replace } else { Existing::Keep }
    }
}

/// Refuses, before any work, to write over what is there.
///
/// # Errors
/// [`Error::Usage`] naming the first file that exists and is to be kept (or has companions that would be read with it),
/// or that is a directory or an input of the command; [`Error::Io`] when a folder does not exist.
pub fn check_outputs(paths: &[&Path], existing: Existing) -> Result<()> {
    for path in paths {
        refuse_input(path)?;
        if is_special(path) {
            continue; // written into, not replaced
        }
        refuse_inputs_beside(path)?;
        if path.is_dir() {
            return Err(Error::usage(format!("the output {} is a directory", path.display()), "name a file"));
        }
        if existing == Existing::Keep && path.exists() {
            return Err(Error::usage(
                format!("the output {} exists", path.display()),
                "give --overwrite to replace it, or name another output",
            ));
        }
        if existing == Existing::Keep {
            refuse_left_behind(path)?;
        }
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        if !folder.is_dir() {
            let missing = std::io::Error::new(std::io::ErrorKind::NotFound, "the folder does not exist");
            return Err(Error::io(folder, "write into", missing));
        }
        refuse_read_only(folder)?;
    }
    Ok(())
}

/// Refuses a folder in which no file can be made, before anything is computed.
///
/// # Errors
/// [`Error::Io`] when the system says that it cannot be written into, or is read-only.
pub fn refuse_read_only(folder: &Path) -> Result<()> {
    use rustix::fs::{Access, access};
    access(folder, Access::WRITE_OK | Access::EXEC_OK).map_err(|e| Error::io(folder, "write into", e.into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_nothing() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a.json");
        let failed = with_temporary(&path, |temporary| {
            std::fs::write(temporary, b"half").map_err(|e| Error::io(temporary, "write", e))?;
            Err(Error::usage("interrupted", "try again"))
        });
        assert!(failed.is_err());
        assert_eq!(std::fs::read_dir(folder.path()).expect("readable").count(), 0);
    }

    struct Fails(PathBuf);
    impl Edit for Fails {
        fn apply(&mut self) -> Result<()> {
            Err(Error::usage("no", "none"))
        }
        fn revert(&mut self) -> Result<()> {
            Ok(())
        }
        fn path(&self) -> &Path {
            &self.0
        }
    }

    #[test]
    fn files_come_together_or_what_was_there_comes_back() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let (old, new) = (folder.path().join("old.txt"), folder.path().join("new.txt"));
        std::fs::write(&old, "before").expect("writable");
        for fail in [true, false] {
            let mut transaction = Transaction::new();
            transaction.stage_bytes(&old, b"after").expect("writable");
            transaction.stage_bytes(&new, b"after").expect("writable");
            if fail {
                transaction.on_commit(Fails(old.clone()));
            }
            assert_eq!(transaction.commit().is_err(), fail);
            let content = std::fs::read_to_string(&old).expect("still there");
            assert_eq!(content, if fail { "before" } else { "after" });
            assert_eq!(new.exists(), !fail);
            let names = std::fs::read_dir(folder.path()).expect("readable").count();
            assert_eq!(names, if fail { 1 } else { 2 }, "temporary files were left");
        }
        let mut dropped = Transaction::new();
        dropped.stage_bytes(&folder.path().join("c"), b"x").expect("writable");
        drop(dropped);
        assert_eq!(std::fs::read_dir(folder.path()).expect("readable").count(), 2);
    }

    #[test]
    fn companions_go_with_what_they_belonged_to_and_come_back_with_it() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let at = |name: &str| folder.path().join(name);
        let left = || {
            let names = std::fs::read_dir(folder.path()).expect("readable").flatten();
            let mut names: Vec<_> = names.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
            names.sort();
            names.join(" ")
        };
        let all = "a.tif a.tif.aux.xml a.tif.msk a.tif.msk.ovr a.tif.ovr b.tif.ovr";
        let begin = || all.split(' ').for_each(|name| std::fs::write(at(name), "old").expect("writable"));
        begin();
        write(&at("a.tif"), b"new").expect("written");
        assert_eq!(left(), "a.tif b.tif.ovr");
        begin();
        for fail in [true, false] {
            let mut both = Transaction::new();
            both.stage_bytes(&at("a.tif"), b"new").expect("staged");
            // What is written with it stays, whichever comes first.
            both.stage_bytes(&at("a.tif.aux.xml"), b"new").expect("staged");
            if fail {
                both.on_commit(Fails(at("a.tif")));
            }
            assert_eq!(both.commit().is_err(), fail);
            assert_eq!(left(), if fail { all } else { "a.tif a.tif.aux.xml b.tif.ovr" });
            let text = std::fs::read_to_string(at("a.tif.aux.xml")).expect("there");
            assert_eq!(text, if fail { "old" } else { "new" });
        }
        assert!(check_outputs(&[&at("b.tif")], Existing::Keep).is_err_and(|e| e.to_string().contains("b.tif.ovr")));
        assert!(check_outputs(&[&at("b.tif")], Existing::Replace).is_ok());
        write(&at("b.tif"), b"new").expect("written");
        assert_eq!(left(), "a.tif a.tif.aux.xml b.tif");
    }

    #[test]
    fn parts_of_runs_that_died_are_removed() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let at = |name: &str| folder.path().join(name);
        // No process has this number: it is above the largest.
        let gone = ".a.4999999.part.json .a.4999999.part.json.before .a.json.4999999.part.ovr.before";
        let kept = ".b.4999999.part.json .a.4999999.part.tif.before .b.json.4999999.part.ovr.before";
        let own = format!(".a.{}.part.json.before", std::process::id());
        let names = || gone.split(' ').chain(kept.split(' ')).chain([own.as_str()]);
        names().for_each(|name| std::fs::write(at(name), "half").expect("writable"));
        assert!(with_temporary(&at("a.json"), |_| Err(Error::usage("no", "none"))).is_err());
        assert!(at(".a.4999999.part.json.before").exists(), "what was replaced can still be had");
        write(&at("a.json"), b"whole").expect("writable");
        let left: Vec<_> = names().filter(|name| at(name).exists()).collect();
        assert_eq!(left.join(" "), format!("{kept} {own}"));
    }

    #[test]
    fn a_shapefile_comes_whole_or_the_old_one_stays_whole() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let at = |name: &str| folder.path().join(name);
        let ends = ["shp", "shx", "dbf"];
        let make = |temporary: &Path| {
            for end in ends {
                std::fs::write(temporary.with_extension(end), "new").map_err(|e| Error::io(temporary, "write", e))?;
            }
            Ok(())
        };
        ends.iter().for_each(|end| std::fs::write(at("a").with_extension(end), "old").expect("writable"));
        // The table cannot be put in place.
        std::fs::remove_file(at("a.dbf")).expect("there");
        std::fs::create_dir_all(at("a.dbf/full")).expect("a folder");
        let read = |end: &str| std::fs::read_to_string(at("a").with_extension(end)).expect("there");
        assert!(with_temporary(&at("a.shp"), make).is_err());
        assert_eq!([read("shp"), read("shx")], ["old", "old"]);
        assert_eq!(std::fs::read_dir(folder.path()).expect("readable").count(), 3, "parts were left");
        std::fs::remove_dir_all(at("a.dbf")).expect("there");
        with_temporary(&at("a.shp"), make).expect("written");
        assert_eq!(ends.map(read), ["new"; 3]);
        assert_eq!(std::fs::read_dir(folder.path()).expect("readable").count(), 3, "second names were left");
    }

    #[test]
    fn a_device_is_written_into() {
        write(Path::new("/dev/null"), b"gone").expect("writable");
        assert!(is_special(Path::new("/dev/null")), "it was replaced");
        assert!(with_temporary(Path::new("/dev/null"), |_| Ok(())).is_err());
    }

    #[test]
    fn two_outputs_of_one_name_are_refused() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let mut transaction = Transaction::new();
        transaction.stage_bytes(&folder.path().join("a"), b"1").expect("writable");
        assert!(transaction.stage_bytes(&folder.path().join("a"), b"2").is_err());
    }

    #[test]
    fn an_existing_output_is_refused_before_any_work() {
        let file = tempfile::NamedTempFile::new().expect("a temporary file");
        assert!(check_outputs(&[file.path()], Existing::Keep).is_err());
        assert!(check_outputs(&[file.path()], Existing::Replace).is_ok());
    }
}
