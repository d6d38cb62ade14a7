//! The files of the console, ready to be sent.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::LazyLock;

use bytes::Bytes;
use http::HeaderValue;
use rust_embed::Embed;
use serde::Deserialize;
use sha2::{Digest, Sha256};

/// What `cargo xtask console` has built before this program was; nothing, if it has not.
#[derive(Embed)]
#[folder = "../console/dist"]
#[allow_missing = true]
struct Embedded;

/// The page itself.
pub(super) const PAGE: &str = "index.html";

/// Says which build it is.
const BUILD: &str = "build.json";

/// Files whose name changes with their content.
const HASHED: &str = "assets/";

/// What pages of others load: the panels, and what these load.
const PANELS: &str = "panels.js";

/// The console as it was built, or none.
#[derive(Debug, Default)]
pub(in crate::web) struct Files {
    build: Option<String>,
    table: BTreeMap<String, File>,
}

/// One file.
#[derive(Debug)]
pub(super) struct File {
    pub(super) media: &'static str,
    /// Whether it may be kept for ever, as another content has another name.
    pub(super) hashed: bool,
    /// Whether it is also for pages of others.
    pub(super) shared: bool,
    pub(super) plain: Content,
    pub(super) gzip: Option<Content>,
}

/// One form of a file.
#[derive(Debug)]
pub(super) struct Content {
    pub(super) bytes: Bytes,
    /// Its entity tag: of another form it is another.
    pub(super) tag: HeaderValue,
}

#[derive(Deserialize)]
struct Build {
    build: String,
}

impl Files {
    /// Those that were built into this program; their tags are made once.
    pub(in crate::web) fn embedded() -> &'static Files {
        static EMBEDDED: LazyLock<Files> = LazyLock::new(Files::read);
        &EMBEDDED
    }

    fn read() -> Files {
        let found = Embedded::iter().filter_map(|path| Some((path.clone(), Embedded::get(&path)?.data)));
        Files::of(found.map(|(path, data)| {
            let bytes = match data {
                Cow::Borrowed(bytes) => Bytes::from_static(bytes),
                Cow::Owned(bytes) => bytes.into(),
            };
            (path.into_owned(), bytes)
        }))
    }

    /// These, by their paths; `FILE.gz` is the same as `FILE`, compressed. Without a page and the name of its build there is no console.
    pub(super) fn of(files: impl IntoIterator<Item = (String, Bytes)>) -> Files {
        let mut all: BTreeMap<String, Bytes> = files.into_iter().collect();
        let names: Vec<String> = all
            .keys()
            .filter(|name| !name.ends_with(".gz"))
            .cloned()
            .collect();
        let mut table = BTreeMap::new();
        for name in names {
            let gzip = all.remove(&format!("{name}.gz")).map(Content::new);
            let Some(plain) = all.remove(&name) else { continue };
            table.insert(name.clone(), File::new(&name, plain, gzip));
        }
        let build = table.get(BUILD).map(|file| &file.plain.bytes[..]);
        let build = build.and_then(|bytes| serde_json::from_slice::<Build>(bytes).ok());
        match build {
            Some(Build { build }) if table.contains_key(PAGE) => Files {
                build: Some(build),
                table,
            },
            _ => Files::default(),
        }
    }

    /// Which build it is, if there is one.
    pub(in crate::web) fn build(&self) -> Option<&str> {
        self.build.as_deref()
    }

    /// The file of this name; names are compared as they stand, so that no way leads out of the table.
    pub(super) fn get(&self, name: &str) -> Option<&File> {
        self.table.get(name)
    }
}

impl File {
    fn new(name: &str, plain: Bytes, gzip: Option<Content>) -> File {
        let hashed = name.starts_with(HASHED);
        File {
            media: media(name),
            hashed,
            shared: hashed || name == PANELS,
            plain: Content::new(plain),
            gzip,
        }
    }
}

impl Content {
    fn new(bytes: Bytes) -> Content {
        let digest = Sha256::digest(&bytes);
        let hex: String = digest[..16].iter().map(|byte| format!("{byte:02x}")).collect();
        let tag = HeaderValue::try_from(format!("\"{hex}\""));
        Content {
            bytes,
            tag: tag.expect("hexadecimal digits in quotes may stand in a header"),
        }
    }
}

/// What is in a file, by its name.
fn media(name: &str) -> &'static str {
    match name.rsplit_once('.').map(|(_, ending)| ending) {
        Some("html") => "text/html; charset=utf-8",
        Some("js" | "mjs") => "text/javascript; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("json" | "map") => "application/json",
        Some("svg") => "image/svg+xml",
        Some("png") => "image/png",
        Some("txt") => "text/plain; charset=utf-8",
        Some("woff2") => "font/woff2",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(files: &[(&str, &str)]) -> Files {
        let owned =
            |(name, text): &(&str, &str)| ((*name).to_owned(), Bytes::copy_from_slice(text.as_bytes()));
        Files::of(files.iter().map(owned))
    }

    #[test]
    fn a_console_has_a_page_and_a_build() {
        let (page, build) = (("index.html", "page"), ("build.json", r#"{"build":"00ff"}"#));
        for (what, built) in [
            (&[page, build][..], Some("00ff")),
            (&[page], None),
            (&[build], None),
            (&[page, ("build.json", "{}")], None),
            (&[page, ("build.json.gz", r#"{"build":"00ff"}"#)], None),
            (&[], None),
        ] {
            let files = files(what);
            assert_eq!(files.build(), built, "{what:?}");
            assert_eq!(files.get(PAGE).is_some(), built.is_some(), "{what:?}");
        }
    }

    #[test]
    fn files_are_known_by_their_names() {
        let files = files(&[
            ("index.html", "page"),
            ("build.json", r#"{"build":"00ff"}"#),
            ("panels.js", "panels"),
            ("panels.js.gz", "smaller"),
            ("icon.svg", "icon"),
            ("assets/page-1a2b.css", "look"),
        ]);
        for (name, media, hashed, shared, gzip) in [
            ("index.html", "text/html; charset=utf-8", false, false, false),
            ("panels.js", "text/javascript; charset=utf-8", false, true, true),
            ("icon.svg", "image/svg+xml", false, false, false),
            (
                "assets/page-1a2b.css",
                "text/css; charset=utf-8",
                true,
                true,
                false,
            ),
        ] {
            let file = files.get(name).unwrap_or_else(|| panic!("{name}"));
            assert_eq!(
                (file.media, file.hashed, file.shared, file.gzip.is_some()),
                (media, hashed, shared, gzip),
                "{name}"
            );
        }
        let panels = files.get("panels.js").expect("it is there");
        let gzip = panels.gzip.as_ref().expect("it is there");
        assert_ne!(panels.plain.tag, gzip.tag);
        for unknown in [
            "",
            "panels.js.gz",
            "assets",
            "assets/",
            "assets/../index.html",
            "./index.html",
            "/index.html",
            "INDEX.HTML",
        ] {
            assert!(files.get(unknown).is_none(), "{unknown}");
        }
    }

    /// Whatever was built before this test was: its parts fit each other.
    #[test]
    fn what_is_built_in_is_whole() {
        let files = Files::embedded();
        let Some(build) = files.build() else {
            assert!(files.table.is_empty());
            return;
        };
        assert!(
            build.len() == 16 && build.bytes().all(|byte| byte.is_ascii_hexdigit()),
            "{build}"
        );
        for (name, file) in &files.table {
            assert_ne!(file.media, "application/octet-stream", "{name}");
            let gzip = file
                .gzip
                .as_ref()
                .unwrap_or_else(|| panic!("{name} has no {name}.gz"));
            assert!(gzip.bytes.starts_with(&[0x1f, 0x8b]), "{name}");
        }
    }
}
