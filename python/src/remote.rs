//! Files behind URLs: COPC files are read by byte ranges, other files are copied.

use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use pyo3::exceptions::PyFileNotFoundError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use snake_io::{Copc, LocalFile, POINT_EXTENSIONS, Ranges};

use crate::error::py_error;

/// The files of a cloud.
pub enum Inputs {
    /// COPC files, at least one of them behind a URL; and for each the object that reads it behind a URL, or its path.
    Copc(Vec<Copc>, Vec<Py<PyAny>>),
    /// Files on disk.
    Local(Vec<PathBuf>),
}

impl Inputs {
    /// Lists the folders and opens the files behind URLs. If not all files are COPC files, copies them to the folder.
    pub fn new(
        py: Python<'_>,
        paths: Vec<PathBuf>,
        folder: &Path,
        storage_options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let url = |path: &Path| path.to_str().filter(|text| text.contains("://")).map(str::to_owned);
        let storage_options = storage_options.map_or_else(|| PyDict::new(py), Clone::clone);
        let module = py.import("snake_rs._remote")?;
        let mut expanded = Vec::new();
        for path in paths {
            // A URL is a folder only if it ends with a slash: asking a web server could read a whole file.
            if path.is_dir() || url(&path).is_some_and(|url| url.ends_with('/')) {
                let clouds = module
                    .call_method1("clouds_in", (path.as_os_str(), POINT_EXTENSIONS.to_vec(), &storage_options))?;
                expanded.extend(clouds.extract::<Vec<PathBuf>>()?);
            } else {
                expanded.push(path);
            }
        }
        let paths = expanded;
        if paths.iter().all(|path| url(path).is_none()) {
            return Ok(Self::Local(paths));
        }
        let class = module.getattr("RemoteFile")?;
        let file = |path: &PathBuf| match url(path) {
            Some(url) => class.call1((url, &storage_options)),
            None => Ok(path.canonicalize()?.into_pyobject(py)?.into_any()),
        };
        let files = paths.iter().map(|path| Ok(file(path)?.unbind())).collect::<PyResult<Vec<_>>>()?;
        if let Some(copc) = open_all(py, &files)? {
            return Ok(Self::Copc(copc, files));
        }
        let local = |(path, file): (&PathBuf, &Py<PyAny>)| match url(path) {
            Some(_) => file.bind(py).call_method1("copy_to", (folder,))?.extract(),
            None => Ok(path.clone()),
        };
        Ok(Self::Local(paths.iter().zip(&files).map(local).collect::<PyResult<_>>()?))
    }

    /// The files that a pickle of the tiles needs.
    pub fn remote(&self, py: Python<'_>) -> Vec<Py<PyAny>> {
        match self {
            Self::Copc(_, files) => files.iter().map(|file| file.clone_ref(py)).collect(),
            Self::Local(..) => Vec::new(),
        }
    }
}

/// Opens files, given as paths or as `RemoteFile`. `None` if not all of them are COPC files, or without files.
pub fn open_all(py: Python<'_>, files: &[Py<PyAny>]) -> PyResult<Option<Vec<Copc>>> {
    if files.is_empty() {
        return Ok(None);
    }
    let open = |file: &Py<PyAny>| {
        let source: Arc<dyn Ranges> = match file.extract::<PathBuf>(py) {
            Ok(path) => Arc::new(LocalFile::new(&path)?),
            Err(_) => Arc::new(RemoteFile::new(file.bind(py))?),
        };
        py.detach(|| Copc::open(source)).map_err(py_error)
    };
    files.iter().map(open).collect()
}

/// A file that is read by a Python object.
#[derive(Debug)]
struct RemoteFile {
    url: PathBuf,
    length: u64,
    version: String,
    object: Py<PyAny>,
}

impl RemoteFile {
    fn new(object: &Bound<'_, PyAny>) -> PyResult<Self> {
        Ok(Self {
            url: object.getattr("url")?.extract()?,
            length: object.getattr("length")?.extract()?,
            version: object.getattr("version")?.extract()?,
            object: object.clone().unbind(),
        })
    }
}

impl Ranges for RemoteFile {
    fn path(&self) -> &Path {
        &self.url
    }

    fn length(&self) -> io::Result<u64> {
        Ok(self.length)
    }

    fn version(&self) -> io::Result<String> {
        Ok(self.version.clone())
    }

    fn read(&self, range: Range<u64>) -> io::Result<Vec<u8>> {
        Python::attach(|py| {
            let bytes = self.object.bind(py).call_method1("read", (range.start, range.end));
            bytes.and_then(|bytes| bytes.extract::<Vec<u8>>()).map_err(|error| {
                let kind = if error.is_instance_of::<PyFileNotFoundError>(py) {
                    io::ErrorKind::NotFound
                } else {
                    io::ErrorKind::Other
                };
                io::Error::new(kind, error.to_string())
            })
        })
    }
}
