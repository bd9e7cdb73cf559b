"""Can it be seen, without the key, that there is a mark: in pictures, or in the attributes of the model?"""
