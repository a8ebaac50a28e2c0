"""The page to try a pair on (``msnet web``): gradio in front of `mobilestereonet.inference`.

`sessions` holds a visitor's files, `uploads` lets pictures in, `answer` matches them, and only
`page` and `server` know gradio.
"""
