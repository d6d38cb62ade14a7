// The frame of the console.
export const shell = {
  title: "MOM",
  skip: "To the page",
  pages: {
    drive: "Drive",
    fleet: "Fleet",
    simulacrum: "Simulacrum",
    modeller: "Modeller",
    contexts: "Contexts",
    peers: "Peers",
    access: "Access",
    audit: "Audit",
    health: "Health",
  } as Record<string, string>,
  navigation: "Pages",
  loading: "Loading…",
  notThere: "This page could not be loaded: the hub may have been upgraded.",
  reload: "Reload",
  newer: "The hub has a newer console than this page.",
  reloading: (seconds: number) => `Reloading in ${seconds} s`,
  later: "Not now",
};
