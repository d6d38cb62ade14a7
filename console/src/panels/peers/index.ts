import { define } from "../../element.svelte.js";
import dialog from "../../parts/dialog.css?inline";
import Peers from "./Peers.svelte";
import css from "./peers.css?inline";

define("mom-peers", Peers, dialog + css);
