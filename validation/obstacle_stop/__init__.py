"""Obstacle stops judged on what a replay wrote: would the stack have stopped?"""
