"""The live page: pad and answers in a browser. Loaded only when configured."""
