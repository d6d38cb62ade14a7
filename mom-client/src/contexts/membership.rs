//! Membership of a context for as long as a caller needs it.

use std::sync::Arc;

use mom_proto::{Code, ContextKind, Map, Path, WireError};
use tokio::time::timeout;

use crate::contexts::client::{Client, Handle};
use crate::peer::shared::{Boxed, Shared};
use crate::peer::wanted::{Terms, Want};
use crate::words::text;
use crate::{ClientError, Events};

/// What comes of joining: the hub's reply is empty for the root.
type Entered = Result<(Membership, Option<Arc<Map>>), ClientError>;

/// Membership of a context and of all above it. When the last one of a context is dropped, the context is left, after
/// all messages sent before.
#[derive(Clone, Debug)]
pub(crate) struct Membership {
    inner: Arc<MembershipState>,
}

#[derive(Debug)]
struct MembershipState {
    handle: Arc<Handle>,
    path: Path,
    /// The contexts, the uppermost first, with their places' serials; without the root, which every peer is in.
    places: Vec<(Path, u64)>,
}

impl Membership {
    pub(crate) fn path(&self) -> &Path {
        &self.inner.path
    }

    pub(crate) fn shared(&self) -> &Arc<Shared> {
        &self.inner.handle.shared
    }

    pub(crate) fn client(&self) -> Client {
        Client::of(Arc::clone(&self.inner.handle))
    }

    pub(crate) fn events(&self) -> Events {
        let shared = self.shared();
        Events::new(
            shared.subscribe(self.path()),
            Arc::clone(shared),
            Some(self.clone()),
        )
    }

    /// Leaves now, even if other proxies exist.
    pub(crate) async fn leave(self) -> Result<(), ClientError> {
        self.shared().leave(self.path()).await
    }
}

impl Drop for MembershipState {
    fn drop(&mut self) {
        self.handle.shared.unwant(&self.places);
    }
}

impl Client {
    /// Joins a context of this kind, parents first.
    pub(crate) async fn enter_kind(
        &self,
        path: &str,
        kind: ContextKind,
        terms: Option<Terms>,
    ) -> Result<Membership, ClientError> {
        let path = Path::parse(path)?;
        let (member, info) = self.enter(&path, terms).await?;
        let found = info
            .as_ref()
            .map_or(Some(ContextKind::Session.word()), |info| text(info, "kind"));
        match found {
            Some(found) if found != kind.word() => {
                let text = format!("{path} is a {found}, not a {kind}");
                Err(ClientError::Local(
                    WireError::new(Code::WRONG_KIND, text).slot("context"),
                ))
            }
            _ => Ok(member),
        }
    }

    /// Joins a context, parents first, on these terms if given.
    pub(crate) fn enter<'a>(&'a self, path: &'a Path, terms: Option<Terms>) -> Boxed<'a, Entered> {
        Box::pin(self.join_in_turn(path, terms))
    }

    async fn join_in_turn(&self, path: &Path, terms: Option<Terms>) -> Entered {
        let shared = &self.handle.shared;
        let (places, wants) = shared.want(&way_to(path), terms.as_ref())?;
        let again = terms.filter(|_| !matches!(wants.last(), Some(Want::Join(_))));
        // From here on the count is released whatever happens.
        let inner = MembershipState {
            handle: Arc::clone(&self.handle),
            path: path.clone(),
            places,
        };
        let member = Membership {
            inner: Arc::new(inner),
        };
        let mut info = None;
        for want in wants {
            let (Want::Join(receiver) | Want::Wait(receiver)) = want else {
                if let Want::Have(known) = want {
                    info = Some(known);
                }
                continue;
            };
            let after = shared.settings.request_timeout;
            let joined = timeout(after, receiver)
                .await
                .map_err(|_| ClientError::TimedOut {
                    what: format!("context join {path}"),
                    after,
                })?;
            info = Some(joined.map_err(|_| ClientError::Connection(format!("{path} was left meanwhile")))??);
        }
        if let Some(terms) = again {
            shared.set_terms(path, terms).await?;
        }
        Ok((member, info))
    }
}

/// The path and those above it, the uppermost first, without the root.
fn way_to(path: &Path) -> Vec<Path> {
    let above = std::iter::successors(Some(path.clone()), Path::parent);
    let mut way: Vec<Path> = above.filter(|path| !path.is_root()).collect();
    way.reverse();
    way
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_way_begins_below_the_root() {
        for (path, expected) in [("/", ""), ("/a", "/a"), ("/a/b/c", "/a /a/b /a/b/c")] {
            let way: Vec<String> = way_to(&Path::parse(path).unwrap())
                .iter()
                .map(Path::to_string)
                .collect();
            assert_eq!(way.join(" "), expected);
        }
    }
}
