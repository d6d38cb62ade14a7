import { define } from "../../element.svelte.js";
import Cursor from "./Cursor.svelte";
import css from "./cursor.css?inline";

define("mom-cursor", Cursor, css, ["device"]);
