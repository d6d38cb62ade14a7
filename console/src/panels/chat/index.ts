import { define } from "../../element.svelte.js";
import Chat from "./Chat.svelte";
import css from "./chat.css?inline";

define("mom-chat", Chat, css, ["path"]);
