// Only the rows of a long list that are seen are rendered.

/** Rows beyond the edges, so that scrolling finds them there. */
const SPARE = 8;

export class Rolling {
  top = $state(0);
  height = $state(0);

  constructor(
    /** px of one row. */
    readonly row: number,
  ) {}

  /** Follows the scrolling of an element: an attachment. */
  readonly attach = (element: HTMLElement): (() => void) => {
    const scrolled = (): void => void (this.top = element.scrollTop);
    const resized = new ResizeObserver(() => (this.height = element.clientHeight));
    element.addEventListener("scroll", scrolled, { passive: true });
    resized.observe(element);
    this.height = element.clientHeight;
    return () => {
      element.removeEventListener("scroll", scrolled);
      resized.disconnect();
    };
  };

  /** Which of so many rows are rendered, and how high the space above and below is, in px. */
  slice(count: number): { from: number; to: number; above: number; below: number } {
    const first = Math.min(Math.floor(this.top / this.row), Math.max(0, count - 1));
    const from = Math.max(0, first - SPARE);
    const to = Math.min(count, first + Math.ceil((this.height || 600) / this.row) + SPARE);
    return { from, to, above: from * this.row, below: Math.max(0, count - to) * this.row };
  }

  /** Scrolls an element so that a row is seen. */
  reveal(element: HTMLElement, index: number, head = 0): void {
    const [top, bottom] = [index * this.row, (index + 1) * this.row];
    if (top < element.scrollTop) element.scrollTop = top;
    else if (bottom > element.scrollTop + element.clientHeight - head) element.scrollTop = bottom - element.clientHeight + head;
  }
}
