/** What was done to a document, to be undone: documents one after another, since none is ever changed. */
export class History<T> {
  #past: T[] = [];
  #future: T[] = [];
  #step: string | undefined;

  /** @param now The document to begin with. */
  constructor(private document: T) {}

  /** The document as it is now. */
  get now(): T {
    return this.document;
  }

  get canUndo(): boolean {
    return this.#past.length > 0;
  }

  get canRedo(): boolean {
    return this.#future.length > 0;
  }

  /**
   * Goes on to another document.
   *
   * @param step Names a step that goes on, such as a slider that is drawn: several with one name are undone as one.
   */
  commit(document: T, step?: string): void {
    if (JSON.stringify(document) === JSON.stringify(this.document)) {
      this.#step = undefined; // a slider that is let go: the next time it is drawn is another step
      return;
    }
    if (step === undefined || step !== this.#step) this.#past = [...this.#past.slice(-499), this.document];
    this.#step = step;
    this.#future = [];
    this.document = document;
  }

  undo(): void {
    const before = this.#past.pop();
    if (before === undefined) return;
    this.#future.push(this.document);
    this.document = before;
    this.#step = undefined;
  }

  redo(): void {
    const after = this.#future.pop();
    if (after === undefined) return;
    this.#past.push(this.document);
    this.document = after;
    this.#step = undefined;
  }
}
