import { define } from "../../element.svelte.js";
import Notices from "./Notices.svelte";
import css from "./notices.css?inline";

define("mom-notices", Notices, css);
