//! Files that take their name only once they are whole.

use std::fs::{self, File};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// A file that is written under a temporary name beside its own, `.NAME.PROCESS.part`, and takes its name, replacing what
/// had it, in [`WholeFile::finish`]. Dropped before that it is removed, and a file of the name stays as it is.
#[derive(Debug)]
pub(crate) struct WholeFile {
    /// `None` once it is whole or given up.
    file: Option<BufWriter<File>>,
    part: PathBuf,
    path: PathBuf,
}

impl WholeFile {
    /// Starts a file.
    pub(crate) fn create(path: &Path) -> io::Result<Self> {
        const BUFFER_BYTES: usize = 1 << 20;
        let part = part_of(path);
        let file = File::create(&part)?;
        Ok(Self { file: Some(BufWriter::with_capacity(BUFFER_BYTES, file)), part, path: path.to_path_buf() })
    }

    /// Brings the file to the disk and gives it its name.
    pub(crate) fn finish(mut self) -> io::Result<()> {
        let file = self.file.take().expect("only finish and drop take the file");
        // Some file systems report a full disk only here.
        let written = file
            .into_inner()
            .map_err(io::IntoInnerError::into_error)
            .and_then(|file| file.sync_all())
            .and_then(|()| fs::rename(&self.part, &self.path));
        if written.is_err() {
            self.remove();
        }
        written
    }

    fn file(&mut self) -> &mut BufWriter<File> {
        self.file.as_mut().expect("only finish and drop take the file")
    }

    fn remove(&self) {
        // Where even that fails there is nothing left to do; the error that matters came before.
        let _ = fs::remove_file(&self.part);
    }
}

impl Write for WholeFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file().flush()
    }
}

impl Seek for WholeFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file().seek(to)
    }
}

impl Drop for WholeFile {
    fn drop(&mut self) {
        if let Some(file) = self.file.take() {
            // Without writing what is left in the buffer. Closed first: some systems do not remove open files.
            drop(file.into_parts());
            self.remove();
        }
    }
}

/// Writes a file by one call, whole or not at all.
pub(crate) fn write_whole(path: &Path, encode: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    let mut file = WholeFile::create(path)?;
    encode(&mut file)?;
    file.finish()
}

/// The name under which a file is written: hidden, and this process's own.
pub(crate) fn part_of(path: &Path) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!(".{name}.{}.part", std::process::id()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_write_that_fails_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("old");
        write_whole(&path, |out| out.write_all(b"old")).unwrap();
        let error = write_whole(&path, |out| {
            out.write_all(b"half a ")?;
            Err(io::ErrorKind::StorageFull.into())
        })
        .unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("old");
        fs::write(&path, "old").unwrap();
        std::os::unix::fs::symlink("/dev/full", part_of(&path)).unwrap();
        let error = write_whole(&path, |out| out.write_all(b"new")).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
