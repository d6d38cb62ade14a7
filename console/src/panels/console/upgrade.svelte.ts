// A page of an older version notices that the hub has been upgraded.

const EVERY = 60_000;
const WAIT = 10;

/** The name of the build that this page belongs to. */
async function own(): Promise<string | undefined> {
  const answer = await fetch(new URL("build.json", document.baseURI));
  const { build } = (await answer.json()) as { build?: string };
  return build;
}

async function hubs(): Promise<string | null | undefined> {
  const answer = await fetch("/api/console", { cache: "no-store" });
  if (!answer.ok) return undefined;
  return ((await answer.json()) as { console?: string | null }).console;
}

export class Upgrade {
  newer = $state(false);
  /** Until the page is loaded anew by itself; not while the user drives, nor after that: it may have lent the robot to an agent. */
  seconds = $state<number | undefined>(undefined);
  #later = false;
  #drove = false;
  #timer: ReturnType<typeof setInterval> | undefined;

  /** `drives` tells whether the page holds a token. */
  constructor(readonly drives: () => boolean) {}

  /** Looks now and then, and whenever the page is looked at again, until the function that it gives is called. */
  watch(): () => void {
    let mine: string | undefined;
    const look = async (): Promise<void> => {
      try {
        mine ??= await own();
        const theirs = await hubs();
        if (mine !== undefined && typeof theirs === "string" && theirs !== mine && !this.#later) this.#found();
      } catch {
        // The hub is away; the link says so.
      }
    };
    void look();
    const timer = setInterval(() => void look(), EVERY);
    const seen = (): void => void (document.visibilityState === "visible" && look());
    document.addEventListener("visibilitychange", seen);
    return () => {
      clearInterval(timer);
      clearInterval(this.#timer);
      document.removeEventListener("visibilitychange", seen);
    };
  }

  #found(): void {
    if (this.newer) return;
    this.newer = true;
    this.#drove ||= this.drives();
    if (!this.#drove) this.seconds = WAIT;
    this.#timer = setInterval(() => {
      this.#drove ||= this.drives();
      this.seconds = this.#drove ? undefined : (this.seconds ?? 1) - 1;
      if (this.seconds !== undefined && this.seconds <= 0) this.reload();
    }, 1000);
  }

  later(): void {
    [this.newer, this.seconds, this.#later] = [false, undefined, true];
    clearInterval(this.#timer);
  }

  reload(): void {
    clearInterval(this.#timer);
    location.reload();
  }
}
