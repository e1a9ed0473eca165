"""Evaluation of obstacle stops on replayed logs: encounters, stop requests, recall and detection range."""
