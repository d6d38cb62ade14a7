// The device of a channel, and its token, for as long as it is driven.
import { asyncDispose } from "../disposal.js";
import type { Channel, Client, Events, Fields, GrabOptions, TokenGuard } from "../index.js";
import { type CarryOutOptions, Commander } from "./commander.js";
import type { Command } from "./course.js";
import { type CommandEnd, DriveError } from "./end.js";

/** A device that is driven by this peer, which owns its token. */
export class Driving {
  readonly commander: Commander;

  /** @internal */
  constructor(
    /** The device's channel. */
    readonly channel: Channel,
    /** The ownership of its token: `guard.lost` is fulfilled when it is over. */
    readonly guard: TokenGuard,
    events: Events,
  ) {
    this.commander = new Commander(channel.client, channel, guard.fence, events);
    void guard.lost.then((lost) => this.commander.lost(lost));
  }

  /** The content of the newest state of the device; undefined before the first. */
  get state(): Fields | undefined {
    return this.commander.state;
  }

  /**
   * Has a command carried out, and gives how it ended. A command that fails does so by its end, not by an exception; also one that ends
   * because the token is lost, or because {@link Driving.end} was called.
   *
   * @throws DriveError while another command is under way.
   */
  carryOut(command: string | Command, options?: CarryOutOptions): Promise<CommandEnd> {
    return this.commander.carryOut(command, options);
  }

  /**
   * Gives the token back, at which the hub halts the device, and hears that the device has ended what runs; it is stopped if it does not
   * say so in two seconds. Once the token is lost it waits for the end of the command under way, and does nothing else.
   *
   * @throws DriveError where the token was not taken back, or the device did not end its command, and was stopped or is silent.
   */
  end(): Promise<void> {
    const { isLost } = this.guard;
    if (isLost) void this.commander.lost(isLost);
    return this.commander.end(() => this.guard.release());
  }

  /** The same, for `await using`. */
  [asyncDispose](): Promise<void> {
    return this.end();
  }
}

/**
 * Joins the channel of a device, and grabs the token that guards it, at once or by way of the queue. With a `guard` that is owned already,
 * such as one that was accepted.
 *
 * ```ts
 * await using arm = await drive(client, "/robot/arm", { wait: 30_000 });
 * const end = await arm.carryOut("home; grip open");
 * if (!end.finished) console.log(end.text, end.hint);
 * ```
 *
 * @throws MomError as {@link Token.grab} does. DriveError where no token guards the channel.
 */
export async function drive(client: Client, path: string, { guard: owned, ...options }: GrabOptions & { guard?: TokenGuard } = {}): Promise<Driving> {
  const channel = await client.channel(path);
  const { guard } = channel;
  if (!guard) throw new DriveError(`no token guards ${path}, so it cannot be owned`);
  // From here on, so that the newest state is known however long the token is waited for.
  const events = channel.events();
  try {
    return new Driving(channel, owned ?? (await (await client.token(guard.token)).grab(options)), events);
  } catch (error) {
    void events.return();
    throw error;
  }
}
