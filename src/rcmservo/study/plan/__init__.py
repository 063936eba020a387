"""What a study is to try: methods, distributions of scenes, and what is done with every pair."""
